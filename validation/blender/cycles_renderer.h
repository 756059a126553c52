// `mirage attack --renderer cycles`: Blender Cycles as the renderer that an attack's detector looks through.
// The pictures are those of the verdict's arm "cycles" (validation/fidelity/vehicle_validation.h): full
// light, over the photograph.
#pragma once

#include <condition_variable>
#include <filesystem>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "attack/object_renderer.h"
#include "validation/reference/reference_renderer.h"

namespace mirage {

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

  /// The object's window and the roof around it, in full_effects(). ReferenceLost where a job was lost as
  /// often as it is tried.
  Window draw(const HostInWorld& host, const TexturedMesh& adversary, const Simulated& simulated,
              std::uint64_t seed) override;
  /// {name, samples, blender, programs}: the last is a hash of the scripts that decide what Blender draws.
  nlohmann::json identity() const override;
  /// Pictures drawn so far.
  int drawn() const { return drawn_; }

 private:
  struct Worker {
    std::filesystem::path scratch;
    std::unique_ptr<ReferenceRenderer> blender;  ///< null until it is wanted
    bool busy = false;
  };
  void start(std::size_t index);
  Worker& take();
  void give(Worker& worker);

  Settings settings_;
  ReferenceIdentity reference_;
  std::vector<Worker> workers_;
  int drawn_ = 0;
  std::mutex mutex_;
  std::condition_variable given_;
};

}  // namespace mirage
