#include <gtest/gtest.h>

#include "base/random.h"
#include "simulation/upstream.h"
#include "support/insertion_world.h"

namespace mirage {
namespace {

using test::make_world;

/// Values that float holds exactly, in float and in double.
template <class S>
std::vector<S> upstream_values(std::size_t count) {
  RandomStream random(7, "upstream");
  std::vector<S> values(count);
  for (S& value : values) value = static_cast<S>(static_cast<float>(random.uniform(-1, 1)));
  return values;
}

template <class S>
AdversaryGradient pulled_back(const Simulated& s) {
  const auto image = upstream_values<S>(s.image.data.size()), points = upstream_values<S>(4 * s.sweep.size());
  return simulate_vjp(
      s, Upstream<S>{image.data(),
                     s.image.width,
                     s.image.height,
                     {reinterpret_cast<const std::array<S, 4>*>(points.data()), s.sweep.size()}});
}

TEST(Upstream, TheCallersMemoryInFloatAndInDouble) {
  const test::World world = make_world(1);
  for (const bool reference : {false, true}) {
    SimulationSettings settings;
    settings.reference = reference;
    const Simulated s = simulate(world.prepared, world.placement, world.adversary, settings);
    ImageF d_image(s.image.width, s.image.height, 3);
    d_image.data = upstream_values<float>(d_image.data.size());
    const auto flat = upstream_values<float>(4 * s.sweep.size());
    std::vector<std::array<float, 4>> d_points(s.sweep.size());
    std::copy(flat.begin(), flat.end(), d_points.front().data());
    const AdversaryGradient own = simulate_vjp(s, d_image, d_points);
    for (const AdversaryGradient& gradient : {pulled_back<float>(s), pulled_back<double>(s)}) {
      EXPECT_EQ(gradient.vertices, own.vertices);
      EXPECT_EQ(gradient.texels, own.texels);
    }
  }
}

TEST(Upstream, TheReturnsInDoubleAreTheSweeps) {
  const test::World world = make_world(2);
  const Simulated s = simulate(world.prepared, world.placement, world.adversary);
  const auto exact = object_returns(s);
  ASSERT_GT(exact.size(), 20u);
  ASSERT_EQ(exact.size(), static_cast<std::size_t>(s.adversary_points));
  for (std::size_t i = 0; i < exact.size(); ++i) {
    const LidarPoint& point = s.sweep[s.sweep.size() - exact.size() + i];
    EXPECT_EQ(point.x, static_cast<float>(exact[i][0]));
    EXPECT_EQ(point.reflectance, static_cast<float>(exact[i][3]));
  }
}

}  // namespace
}  // namespace mirage
