// The headless Blender worker (blender_worker.py) from the C++ side: JSON lines over a socket.
#pragma once

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "base/error.h"
#include "base/image.h"
#include "sensors/lidar_model.h"
#include "validation/process.h"

namespace mirage {

/// Blender was lost on one job as often as it is tried.
class BlenderLost : public Failure {
 public:
  using Failure::Failure;
};

/// The Python programs that decide what Blender draws: the worker's own and the add-on's package.
std::vector<std::filesystem::path> renderer_programs();

/// InputError if the name of an output folder is no UTF-8: Blender is told of its files in JSON.
void require_text_path(const std::filesystem::path& out);

class BlenderWorker {
 public:
  /// How often a job is sent before it is given up.
  static constexpr int kAttempts = 3;
  /// A worker that was lost on a job.
  struct Loss {
    std::string job, how;  ///< how: "ended unexpectedly", "gave no answer in 900 s", …
    int attempt = 1;       ///< at the job, from 1
  };

  /// Starts Blender and waits for its first answer. `log` receives what Blender prints. One that dies while
  /// it starts is started again, kAttempts times in all. InputError if `program` is not on PATH; Failure if
  /// it dies each time or does not answer within `start_timeout` seconds.
  explicit BlenderWorker(std::filesystem::path log, std::string program = "blender",
                         double start_timeout = 120);
  ~BlenderWorker();

  /// Sends a job and returns its answer. A worker that dies, has not answered `timeout` seconds after it was
  /// asked (whatever else it says meanwhile) or answers with something else than the protocol's JSON is
  /// started again and the job is sent once more, kAttempts times in all: then BlenderLost. Failure if the
  /// job itself is answered with an error. Interrupted after Ctrl-C.
  nlohmann::json request(nlohmann::json job, double timeout);

  pid_t pid() const { return child_ ? child_->pid() : -1; }
  /// How often the worker was started again.
  int restarts() const { return restarts_; }
  /// Every loss since the start, in order.
  const std::vector<Loss>& losses() const { return losses_; }
  const std::string& version() const { return version_; }

 private:
  void start();
  /// False, with the reason in lost_, if there is no answer. `starting`: what Blender prints before the
  /// worker's script runs is passed over.
  bool exchange(const nlohmann::json& job, double timeout, nlohmann::json& answer, bool starting = false);

  std::filesystem::path log_, program_, script_;
  double start_timeout_;
  std::unique_ptr<ChildProcess> child_;
  std::string version_, lost_;  ///< lost_: how the worker was lost last
  int restarts_ = 0;
  std::vector<Loss> losses_;
  long next_id_ = 0;
};

/// What a render adds to matched light (ambient + hemisphere + sun without shadows, Lambert, no bounces).
struct RenderEffects {
  bool shadows = false;  ///< sun of 0.53° with shadows
  bool sky = false;      ///< ambient light from a sky, so that it can be occluded
  int bounces = 0;
  bool specular = false;  ///< Principled BSDF, specular 0.5, roughness 0.5
  bool paint = false;  ///< the host's car paint: a clear coat over its colour, which mirrors onto the object
  /// With `sky`: Nishita's clear sky for the sun's elevation (without its disc), its gain matched so that a
  /// face that looks straight up receives as much light (luminance) as from the light model.
  bool clear_sky = false;
  enum class Surroundings {
    none,     ///< the adversary alone
    unseen,   ///< host and ground shadow, occlude and reflect, but the camera does not see them
    catcher,  ///< … and catch shadows for compositing
  } surroundings = Surroundings::none;
};

struct RenderJob {
  std::filesystem::path scene, output;  ///< .glb in, multilayer EXR out
  PixelRect rect;
  int samples = 1;
  std::uint64_t seed = 0;
  bool pixel_centre = false;  ///< sample the pixel's centre alone, as a rasteriser does; else its area
  int threads = 0;            ///< of Cycles; 0: all cores. The picture is the same
  double filter_width = 0;  ///< px, of a Blackman–Harris pixel filter in place of the pixel's area; 0: area
  RenderEffects effects;
};

struct Rendered {
  ImageF rgba;     ///< rect-sized, premultiplied, scene-linear
  ImageF catcher;  ///< rect-sized RGB: factor by which what lies behind is darkened; empty without catcher
  double seconds = 0;
};

/// Renders with Cycles and reads the picture back.
Rendered render(BlenderWorker& blender, const RenderJob& job);

/// Distance along each ray to the adversary of the scene by Blender's BVH; −1 where it is missed.
std::vector<double> raycast(BlenderWorker& blender, const std::filesystem::path& scene,
                            std::span<const LidarRay> rays, const std::filesystem::path& scratch);

}  // namespace mirage
