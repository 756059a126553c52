// The headless Blender worker (blender_worker.py) from the C++ side: JSON lines over a socket.
#pragma once

#include <condition_variable>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "attack/observation.h"
#include "base/child_process.h"
#include "geometry/mesh.h"
#include "validation/reference/reference_renderer.h"

namespace mirage {

/// The Python programs that decide what Blender draws: the worker's own and the add-on's package.
std::vector<std::filesystem::path> renderer_programs();

/// InputError if the name of an output folder is not UTF-8: Blender gets its file names in JSON.
void require_text_path(const std::filesystem::path& out);

/// Cycles as a reference renderer, in a Blender that stays alive from job to job.
class BlenderWorker : public ReferenceRenderer {
 public:
  /// How often a job is sent before it is given up.
  static constexpr int kAttempts = 3;

  /// Starts Blender and waits for its first answer. `log` receives Blender's output. A Blender that dies
  /// while it starts is started again, kAttempts times in all. InputError if `program` is not on PATH;
  /// Failure if it dies each time or does not answer within `start_timeout` seconds.
  explicit BlenderWorker(std::filesystem::path log, std::string program = "blender",
                         double start_timeout = 120);
  ~BlenderWorker() override;

  /// Sends a job and returns its answer. A worker that dies, does not answer within `timeout` seconds
  /// (whatever it prints meanwhile), or breaks the JSON protocol is started again. The job is then sent once
  /// more, kAttempts times in all: then ReferenceLost. Failure if the job itself is answered with an error.
  /// Interrupted after Ctrl-C.
  nlohmann::json request(nlohmann::json job, double timeout);
  /// With Cycles, through a multilayer EXR at job.output.
  Rendered render(const RenderJob& job) override;
  /// By Blender's BVH.
  std::vector<double> raycast(const std::filesystem::path& scene, std::span<const LidarRay> rays,
                              const std::filesystem::path& scratch) override;
  /// Writes standing_on_origin(adversary) (exchange/mesh_files.h) as FBX: metres, pivot on the roof socket,
  /// one material whose embedded picture has the texels at 8 bits sRGB, a pixel each. Written beside `file`
  /// first, so that `file` is always complete.
  void write_fbx(const std::filesystem::path& file, const TexturedMesh& adversary);

  /// Its programs: renderer_programs().
  ReferenceIdentity identity() const override;
  pid_t pid() const { return child_ ? child_->pid() : -1; }
  /// How often the worker was started again.
  int restarts() const { return restarts_; }
  const std::vector<ReferenceLoss>& losses() const override { return losses_; }
  const std::string& version() const { return version_; }

 private:
  void start();

  std::filesystem::path log_, program_, script_;
  double start_timeout_;
  std::unique_ptr<JsonWorker> child_;
  std::string version_;
  int restarts_ = 0;
  std::vector<ReferenceLoss> losses_;
};

/// Starts Blender for a command that writes into `out`: makes the folder; `log` in it receives Blender's
/// output. Errors of require_text_path, make_output_folder and BlenderWorker. A StartReference.
std::unique_ptr<ReferenceRenderer> start_blender(const std::filesystem::path& out,
                                                 const std::string& log = "blender.log",
                                                 const std::string& program = "blender");

// `mirage attack --renderer cycles`: Blender Cycles as the renderer that an attack's detector looks through.
// The pictures are those of the verdict's arm "cycles" (validation/fidelity/vehicle_validation.h): full
// light, over the photograph.

/// Blender workers that live as long as it does, each drawing one host at a time.
class CyclesRenderer : public ObjectRenderer {
 public:
  struct Settings {
    std::filesystem::path out;  ///< gets blender*.log, and kScratchFolder as long as it lives
    int samples = 16;           ///< a pixel
    int workers = 1;            ///< at most; they share this process's threads
    std::string program = "blender";
  };
  /// Starts the first worker. InputError if Blender is missing or `out` is no text; Failure if it does not
  /// start.
  explicit CyclesRenderer(const Settings& settings);
  ~CyclesRenderer() override;

  /// Draws the window of the object and the roof around it, in full_effects(). ReferenceLost if a job was
  /// lost at every attempt.
  Window draw(const HostInWorld& host, const TexturedMesh& adversary, const Simulated& simulated,
              std::uint64_t seed) override;
  /// {name, samples, blender, programs}: the last is a hash of the scripts that decide what Blender draws.
  nlohmann::json identity() const override;
  /// Pictures drawn so far.
  int drawn() const { return drawn_; }

 private:
  struct Worker {
    std::filesystem::path scratch;
    std::unique_ptr<ReferenceRenderer> blender;  ///< null until it is needed
    bool busy = false;
  };
  /// The lease of a worker for one picture; the worker is free again when it ends.
  using Lease = std::unique_ptr<Worker, std::function<void(Worker*)>>;
  void start(std::size_t index);
  Lease take();

  Settings settings_;
  ReferenceIdentity reference_;
  std::vector<Worker> workers_;
  int drawn_ = 0;
  std::mutex mutex_;
  std::condition_variable given_;
};

}  // namespace mirage
