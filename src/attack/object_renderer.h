// A renderer that an attack's detector looks through in the place of the rasteriser: its pictures are better,
// take their time and have no derivative. The attack knows no more of it than this
// (validation/blender/cycles_renderer.h is Blender Cycles).
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>

#include "attack/attack_settings.h"
#include "frames/hosts.h"

namespace mirage {

/// A host in the world that a step sees it in.
struct HostInWorld {
  const PreparedFrame& prepared;
  const HostId& host;
  const Placement& placement;  ///< at the host, or one drawn (attack/expectation.h)
  const SimulationSettings& simulation;
  std::uint64_t world = 0;  ///< which draw it is of; 0: as recorded, or the only one
};

/// Draws placed objects. Several threads may ask at a time.
class ObjectRenderer {
 public:
  /// A part of the photograph.
  struct Window {
    PixelRect rect;  ///< inside the photograph
    ImageF picture;  ///< rect-sized RGB: the photograph with the object in it, scene-linear, not clamped
  };
  virtual ~ObjectRenderer() = default;
  /// The placed object, behind what the photograph shows in front of it; the same bits for the same
  /// arguments. `simulated`: what the insertion makes of them. Failure if the renderer is lost for good.
  virtual Window draw(const HostInWorld& host, const TexturedMesh& adversary, const Simulated& simulated,
                      std::uint64_t seed) = 0;
  /// What decides its pictures, for a run's identity.
  virtual nlohmann::json identity() const = 0;
};

// An attack's detector looks at the pictures of an ObjectRenderer, and the gradient goes through the
// insertion's own rasteriser. With x the mesh, R the rasteriser's picture, C the renderer's and x₀ the mesh
// that C was last drawn of, the detector is shown
//
//     P(x) = R(x) + (C(x₀) − R(x₀))
//
// and d P / d x = d R / d x: R is the control variate of C (Owen, Monte Carlo theory, methods and examples,
// 2013, section 8.9). Where x = x₀ the detector sees C itself, with the gradient taken straight through
// (Bengio, Léonard, Courville, 2013); between two draws the picture still follows the mesh. x₀ is one mesh
// for all hosts: a checkpoint holds it, and the pictures are made anew from it to the same bits.

/// The mesh that pictures are drawn of, and the number of steps after which it was the adversary's.
struct RenderedMesh {
  long iteration = -1;  ///< −1: of no step of the attack
  TexturedMesh mesh;
};

/// Whether it has moved further, in either way. With 0 every change counts.
bool has_moved(const TexturedMesh& from, const TexturedMesh& to, const Renewal& renewal);

/// Corrections C(x₀) − R(x₀), kept while x₀ stays. Several threads may ask.
class RenderedPictures {
 public:
  /// Noise is drawn by seed, host and iteration. `renderer` outlives it.
  RenderedPictures(ObjectRenderer& renderer, std::uint64_t seed) : renderer_(renderer), seed_(seed) {}

  /// Turns R(adversary), which `simulated` holds, into P: image and radiance. Returns the window that changed
  /// beside `simulated.rect`. Pictures of a mesh of no step (iteration −1) are not kept.
  PixelRect correct(const HostInWorld& host, const TexturedMesh& adversary, const RenderedMesh& rendered,
                    Simulated& simulated);

 private:
  struct Correction {
    std::uint64_t world = 0;
    PixelRect rect;
    ImageF difference;  ///< rect-sized
  };
  std::shared_ptr<const Correction> make(const HostInWorld& host, const TexturedMesh& adversary,
                                         const RenderedMesh& rendered, const Simulated& simulated) const;

  ObjectRenderer& renderer_;
  std::uint64_t seed_;
  std::mutex mutex_;
  long iteration_ = -1;                                                   ///< that the kept ones are of
  std::size_t kept_ = 0;                                                  ///< values
  std::map<std::string, std::shared_ptr<const Correction>> corrections_;  ///< by host
};

}  // namespace mirage
