// The studies' scratch folder below their output folder, which they remove at the end.
#pragma once

#include <fmt/format.h>

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "base/error.h"
#include "base/image.h"
#include "base/provenance.h"
#include "base/ranks.h"
#include "sensors/lidar_model.h"

namespace mirage {

/// A folder below --out. It is removed with its contents, so its name is one that no user chooses.
inline constexpr const char* kScratchFolder = ".mirage-scratch";

/// This process's own scratch folder below `out`, which other ranks leave alone (base/ranks.h).
inline std::filesystem::path scratch_folder(const std::filesystem::path& out) {
  std::filesystem::path folder = out / kScratchFolder;
  if (rank() > 0) folder += fmt::format("-{}", rank());
  return folder;
}

// The reference in place of reality: a renderer of physically based light that the light-weight ones are
// compared with. Blender Cycles is one (validation/blender/blender_process.h).

/// The renderer was lost at every attempt at one job.
class ReferenceLost : public Failure {
 public:
  using Failure::Failure;
};

/// A renderer that was lost on a job.
struct ReferenceLoss {
  std::string job, how;  ///< how: "ended unexpectedly", "gave no answer in 900 s", …
  int attempt = 1;       ///< at the job, from 1
};
template <class Visitor, FieldsOf<ReferenceLoss> S>
void visit_fields(Visitor& visit, S& s) {
  visit_named(visit, "job", s.job, "how", s.how);
  visit({.name = "attempt", .range = kFromOne}, s.attempt);
}

/// The effects added to matched light (ambient + hemisphere + sun without shadows, Lambert, no bounces).
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
  std::filesystem::path scene, output;  ///< .glb (exchange/gltf.h) in; where a picture file may be put
  PixelRect rect;
  int samples = 1;
  std::uint64_t seed = 0;
  bool pixel_centre = false;  ///< sample the pixel's centre alone, as a rasteriser does; else its area
  int threads = 0;            ///< 0: all cores. The picture is the same
  double filter_width = 0;  ///< px, of a Blackman–Harris pixel filter in place of the pixel's area; 0: area
  RenderEffects effects;
};

struct Rendered {
  ImageF rgba;     ///< rect-sized, premultiplied, scene-linear
  ImageF catcher;  ///< rect-sized RGB: factor that darkens the background; empty without catcher
  double seconds = 0;
};

/// The renderer, and the files that decide its picture.
struct ReferenceIdentity {
  std::string key;   ///< of files: "blender"
  std::string name;  ///< for readers: "Blender Cycles"
  std::string version;
  std::vector<std::filesystem::path> programs;  ///< files that decide what it draws
  /// Version and the programs' content. InputError if one can't be read.
  void add_to(Provenance& provenance) const {
    for (const std::filesystem::path& program : programs) provenance.file(program.filename(), program);
    provenance.input(key, version);
  }
};

class ReferenceRenderer {
 public:
  virtual ~ReferenceRenderer() = default;
  /// Renders the scene's adversary and its shadow. The same job gives the same picture; one of another seed
  /// has independent noise. ReferenceLost, Failure for a job that can't be done, Interrupted.
  virtual Rendered render(const RenderJob& job) = 0;
  /// Distance along each ray (`velo`, m) to the adversary of the scene; −1 where it is missed. `scratch`: a
  /// folder for temporary files. Errors as render().
  virtual std::vector<double> raycast(const std::filesystem::path& scene, std::span<const LidarRay> rays,
                                      const std::filesystem::path& scratch) = 0;
  virtual ReferenceIdentity identity() const = 0;
  /// Every loss since the start, in order; each was followed by a new start.
  virtual const std::vector<ReferenceLoss>& losses() const = 0;
};

/// Starts the renderer for a command that writes into `out`, which is made. InputError where it is not
/// installed or `out` can't be used; Failure if it does not start.
using StartReference = std::function<std::unique_ptr<ReferenceRenderer>(const std::filesystem::path& out)>;

}  // namespace mirage
