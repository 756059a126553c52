// A sensor of a frame as an insertion sees it: what the placed object changes of its measurement, and the way
// back. Cameras and the LiDAR are passes (insertion.cpp), and so is every sensor plugin (sensor_plugin.h).
#pragma once

#include <memory>

#include "simulation/placement.h"
#include "simulation/simulation.h"
#include "simulation/upstream.h"

namespace mirage {

/// What one drawing left for its VJP.
class SensorTape {
 public:
  virtual ~SensorTape() = default;
  /// Adds d loss / d vertices (of the placed object, `velo`) and d loss / d texels to `placed`, by this
  /// sensor's part of the upstream. `simulated`: what the drawing was into.
  virtual void vjp(const Simulated& simulated, const TexturedMesh& object, const Upstream<float>& upstream,
                   AdversaryGradient& placed) const = 0;
  virtual void vjp(const Simulated& simulated, const TexturedMesh& object, const Upstream<double>& upstream,
                   AdversaryGradient& placed) const = 0;
};

/// A SensorTape whose `add` is written once for both precisions.
template <class Self>
class SensorTapeOf : public SensorTape {
 public:
  void vjp(const Simulated& simulated, const TexturedMesh& object, const Upstream<float>& upstream,
           AdversaryGradient& placed) const override {
    static_cast<const Self&>(*this).add(simulated, object, upstream, placed);
  }
  void vjp(const Simulated& simulated, const TexturedMesh& object, const Upstream<double>& upstream,
           AdversaryGradient& placed) const override {
    static_cast<const Self&>(*this).add(simulated, object, upstream, placed);
  }
};

/// One sensor. Several threads may draw at once.
class SensorPass {
 public:
  virtual ~SensorPass() = default;
  /// Writes this sensor's measurement with the object in it into `result`. `placed`: in `velo`. Null where
  /// the object changes nothing and there is no way back.
  virtual std::unique_ptr<SensorTape> draw(const PreparedFrame& prepared, const Placement& placement,
                                           const TexturedMesh& placed, const SimulationSettings& settings,
                                           Simulated& result) const = 0;
};

}  // namespace mirage
