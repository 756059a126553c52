// A renderer that an attack's detector looks through in the place of the rasteriser: its pictures are better,
// take their time and have no derivative. The attack knows no more of it than this
// (validation/blender/cycles_renderer.h is Blender Cycles).
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>

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

}  // namespace mirage
