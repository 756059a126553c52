// Windows of a plan against its whole maps, and their share of the work.
#include <gtest/gtest.h>
#include <torch/torch.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>

#include "base/sizes.h"
#include "detection/average_precision.h"
#include "detection/car_in_picture.h"
#include "generator/generator.h"
#include "geometry/box.h"
#include "local_network.h"
#include "sampling.h"
#include "scene/data/read_frames.h"
#include "support/files.h"
#include "tensor_checks.h"
#include "weights.h"

namespace mirage::fusion {
namespace {

using torch::Tensor;

TEST(ChangedRegion, HoldsWhatReadsAChangedPlace) {
  for (const Reach& reach : {Reach{3, 1, 1}, {2, 2, 0}, {4, 2, 1}, {3, 2, 1}, {13, 1, 6}, {1, 1, 0}}) {
    const std::int64_t rows = 14, columns = 20, out_rows = rows / reach.stride,
                       out_columns = columns / reach.stride;
    ChangedRegion dirty(rows, columns);
    dirty.add(Window{3, 5, 5, 9});
    dirty.add(11, 0);
    dirty.add(13, 19);
    const ChangedRegion out = dirty.through(reach, out_rows, out_columns);
    for (std::int64_t r = 0; r < out_rows; ++r)
      for (std::int64_t c = 0; c < out_columns; ++c) {
        const Window read = read_by({r, c, r + 1, c + 1}, reach);
        bool reads = false;
        for (std::int64_t i = std::max<std::int64_t>(0, read.top); i < std::min(rows, read.bottom); ++i)
          reads =
              reads || (dirty.row(i).low < std::min(read.right, columns) &&
                        dirty.row(i).high > std::max<std::int64_t>(0, read.left) && !dirty.row(i).empty());
        const bool held = !out.row(r).empty() && c >= out.row(r).low && c < out.row(r).high;
        EXPECT_TRUE(held || !reads) << reach.kernel << " at " << r << " " << c;
        EXPECT_EQ(reached_by(read, reach, out_rows, out_columns).empty(), false);
      }
    EXPECT_LT(out.area(), out_rows * out_columns);
    std::int64_t covered = 0;
    for (const Window& window : out.windows(8)) covered += window.area();
    EXPECT_GE(covered, out.area());
  }
  EXPECT_TRUE(ChangedRegion(5, 5).windows(8).empty());
}

/// Every kind of layer, at odd sizes.
struct Mixed {
  Plan plan;
  int input = 0, added = 0, output = 0;
  Mixed() {
    torch::manual_seed(31);
    const auto weight = [](int out, int in, int k) {
      return torch::randn({out, in, k, k}) / std::sqrt(in * k * k);
    };
    const auto bias = [](int out) { return torch::randn({out}) * 0.1; };
    input = plan.input(5, 46, 70, false);
    const int a = plan.conv(input, weight(8, 5, 4), bias(8), 2, 1, Curve::relu);  // 23 × 35
    const int b = plan.conv(a, weight(8, 1, 3), bias(8), 1, 8, Curve::silu);
    added = plan.input(8, 23, 35, true);
    const int c = plan.sum(b, added, Curve::none);
    const int d = plan.conv(c, weight(12, 8, 2), bias(12), 2, 1, Curve::silu);  // 12 × 18
    const int e = plan.join({d, plan.max_pool(d, 5)});
    const int f = plan.conv(e, weight(8, 24, 1), bias(8), 1, 1, Curve::none);
    const int up = plan.upsample(f, 23);
    Plan& p = plan;
    const int g = p.conv(c, weight(8, 8, 3), bias(8), 1, 1, Curve::relu);
    const int wide = p.conv(p.upsample(p.average_pool(up), 22), weight(8, 8, 1), bias(8), 1, 1, Curve::relu);
    (void)g;
    output = p.conv(wide, weight(3, 8, 3), bias(3), 1, 1, Curve::none);
    p.keep(output);
  }
};

/// The same with LibTorch's operators.
Tensor whole(const Plan& plan, std::vector<Tensor> maps, int output) {
  for (std::size_t i = 0; i < plan.layers().size(); ++i) {
    const Layer& layer = plan.layers()[i];
    const auto in = [&](std::size_t k) { return maps[as_size(layer.from[k])]; };
    Tensor& y = maps[i];
    if (layer.op == Layer::Op::conv) {
      const Window read = read_by(layer.whole(), layer.reach);
      const Tensor x = torch::constant_pad_nd(
          in(0), {-read.left, read.right - in(0).size(3), -read.top, read.bottom - in(0).size(2)});
      const std::vector<std::int64_t> stride(2, layer.reach.stride), none(2, 0), one(2, 1);
      y = torch::conv2d(x, layer.weight, layer.bias, stride, none, one, layer.groups);
    } else if (layer.op == Layer::Op::sum) {
      y = in(0) + in(1);
    } else if (layer.op == Layer::Op::join) {
      y = torch::cat({in(0), in(1)}, 1);
    } else if (layer.op == Layer::Op::upsample) {
      y = torch::upsample_nearest2d(in(0), {2 * in(0).size(2), 2 * in(0).size(3)}).narrow(2, 0, layer.rows);
    } else if (layer.op == Layer::Op::max_pool) {
      y = torch::max_pool2d(in(0), layer.reach.kernel, 1, layer.reach.padding);
    } else if (layer.op == Layer::Op::average_pool) {
      y = torch::avg_pool2d(in(0), 2);
    }
    if (layer.curve == Curve::relu) y = torch::relu(y);
    if (layer.curve == Curve::silu) y = torch::silu(y);
  }
  return maps[as_size(output)];
}

TEST(LocalPass, EveryLayerForwardAndBackwardIsThatOfTheWholeMap) {
  const Mixed mixed;
  const auto count = mixed.plan.layers().size();
  std::vector<Tensor> given(count);
  given[as_size(mixed.input)] = torch::randn({1, 5, 46, 70});
  given[as_size(mixed.added)] = torch::randn({1, 8, 23, 35});
  const CleanMaps clean = run(mixed.plan, given);
  for (const Window& at : {Window{20, 30, 23, 36}, {0, 0, 2, 3}, {44, 66, 46, 70}, {10, 0, 12, 70}}) {
    Tensor x = given[as_size(mixed.input)].clone();
    x.narrow(2, at.top, at.rows()).narrow(3, at.left, at.columns()).add_(1);
    x.requires_grad_(true);
    std::vector<Tensor> changed = given;
    changed[as_size(mixed.input)] = x;
    const Tensor expected = whole(mixed.plan, changed, mixed.output);
    LocalPass pass(mixed.plan, clean);
    ChangedRegion dirty(46, 70);
    dirty.add(at);
    pass.give(mixed.input, dirty, [&](const Window& window) {
      return torch::constant_pad_nd(x.detach(),
                                    {-window.left, window.right - 70, -window.top, window.bottom - 46})
          .contiguous(torch::MemoryFormat::ChannelsLast);
    });
    pass.forward();
    const Tensor found = pass.whole(mixed.output);
    EXPECT_LT((found - expected).abs().max().item<double>(), 1e-5);
    for (const bool everywhere : {true, false}) {
      Tensor weights = torch::randn(expected.sizes());
      if (!everywhere) {
        weights.zero_();
        weights[0][1][std::min<std::int64_t>(at.top / 2, 21)][at.left / 2] = 1;
      }
      const Tensor d = torch::autograd::grad({expected}, {x}, {weights}, true)[0];
      LocalPass again = pass;
      again.add_gradient(mixed.output, mixed.plan[mixed.output].whole(), weights);
      again.backward();
      const auto inside = [&](const Tensor& map) {
        return map.narrow(2, at.top, at.rows()).narrow(3, at.left, at.columns());
      };
      EXPECT_LT((again.gradient(mixed.input, at) - inside(d)).abs().max().item<double>(), 1e-5) << everywhere;
      EXPECT_GT(inside(d).abs().max().item<double>(), 0);
    }
  }
}

/// KITTI's picture and a road of returns, with an object on a car's roof that hides what lies behind it.
struct Road {
  SensorTensors clean, changed;
  Window pixels;
  Road(double range, double side) {
    torch::manual_seed(32);
    clean.image = torch::rand({375, 1242, 3});
    clean.projection = {610, -720, 0, 0, 172, 0, -720, -60, 1, 0, 0, 0};
    std::vector<float> points, left;
    const auto add = [](std::vector<float>& to, double x, double y, double z) {
      to.insert(to.end(), {static_cast<float>(x), static_cast<float>(y), static_cast<float>(z), 0.f});
    };
    const double bearing = std::atan2(side, range), half = 0.8 / std::hypot(range, side);
    for (int beam = 0; beam < 64; ++beam)
      for (int column = -230; column < 230; ++column) {
        const double azimuth = column * 0.003, down = 0.02 + 0.0065 * beam, far = std::min(70.0, 1.73 / down);
        add(points, far * std::cos(azimuth), far * std::sin(azimuth), down * far > 1.7 ? -1.73 : -1.2);
        // The object's shadow, as long as rays just above its roof still meet the road.
        const bool hidden = std::abs(azimuth - bearing) < half && far > std::hypot(range, side) && beam < 4;
        if (!hidden) left.insert(left.end(), points.end() - 4, points.end());
      }
    for (int i = 0; i < 200; ++i)
      add(left, range + 0.006 * (i - 100), side + 0.5 * std::sin(i), -0.2 + 0.002 * i);
    const auto rows = [](const std::vector<float>& p) { return torch::tensor(p).view({-1, 4}).clone(); };
    clean.points = rows(points);
    changed = clean;
    changed.points = rows(left);
    const std::array<float, 3> top = {static_cast<float>(range), static_cast<float>(side), 0.2f};
    const auto seen = seen_at(top.data(), clean.projection, 1242, 375);
    const auto across = static_cast<std::int64_t>(720 * 0.8 / range) + 1;
    if (!seen) throw std::logic_error("the object is out of the picture");
    const auto u = static_cast<std::int64_t>(seen->u), v = static_cast<std::int64_t>(seen->v);
    pixels = intersection({v - across / 2, u - across, v + across, u + across}, {0, 0, 375, 1242});
    changed.image = clean.image.clone();
    changed.image.narrow(0, pixels.top, pixels.rows()).narrow(1, pixels.left, pixels.columns()).mul_(0.3);
  }
};

TEST(LocalNetwork, LocalityLeavesTheFarAsItWas) {
  for (const std::string name : {"lidar", "camera", "painted", "fusion", "late", "refined"}) {
    torch::manual_seed(34);
    Network network(parts_named(name));
    for (Tensor& parameter : network->parameters()) parameter.requires_grad_(false);
    CleanActivationCache frames(network, std::size_t{1} << 30);
    const Road road(10, 0);
    const auto clean = frames.of(1, [&] { return road.clean; });
    const auto answer = [&](double locality) {
      LocalNetwork local(network, clean, road.changed, road.pixels, locality);
      return std::pair(
          (local.output().defined() ? local.output().select(0, kLogit) : local.seen().logits).flatten(),
          local.work());
    };
    const auto [exact, whole_work] = answer(0);
    double before = 1e30, work = 0;
    for (const double metres : {1.0, 4.0, 100.0}) {
      const auto [found, spent] = answer(metres);
      const double error = (found - exact).norm().item<double>();
      std::printf("%-8s %3.0f m: work %.2f of the exact pass's, error of the logits %.1e\n", name.c_str(),
                  metres, spent / whole_work, error);
      EXPECT_LE(error, before) << name << " " << metres;
      EXPECT_GE(spent, work) << name << " " << metres;
      before = error, work = spent;
      if (metres == 1) {
        EXPECT_LT(spent, 0.7 * whole_work) << name;
      }
    }
    EXPECT_EQ(before, 0) << name;  // 100 m cover the whole grid: nothing is cut
    EXPECT_EQ(work, whole_work) << name;
  }
}

TEST(LocalNetwork, DoesAShareOfTheWork) {
  for (const char* name : {"lidar", "camera", "painted", "fusion", "late", "refined"}) {
    torch::manual_seed(33);
    Network network(parts_named(name));
    for (Tensor& parameter : network->parameters()) parameter.requires_grad_(false);
    CleanActivationCache frames(network, std::size_t{1} << 30);
    for (const auto& [range, side] : {std::pair{10.0, 0.0}, {40.0, -5.0}}) {
      const Road road(range, side);
      const auto clean = frames.of(static_cast<std::uint64_t>(range), [&] { return road.clean; });
      LocalNetwork local(network, clean, road.changed, road.pixels);
      const double whole_work = local.whole_work(), forward = local.work() / whole_work;
      // Ten proposals around the host.
      Tensor d_logits = torch::zeros({local.logit_count()});
      if (local.output().defined()) {
        const auto row = static_cast<std::int64_t>(range / 0.5),
                   column = static_cast<std::int64_t>((side + 40) / 0.5);
        for (int k = 0; k < 10; ++k) d_logits[(row + k / 5) * kCellsY + column + k % 5] = 1.f;
      } else {
        const std::vector<Place> places = places_of(375, 1242);
        const double middle = static_cast<double>(road.pixels.left + road.pixels.right) / 2;
        const auto bottom = static_cast<float>(road.pixels.bottom);
        for (std::size_t p = 0, set = 0; p < places.size() && set < 10; ++p)
          if (std::abs(places[p].x - middle) < 12 && places[p].y > bottom && places[p].y < bottom + 30)
            d_logits[static_cast<std::int64_t>(p)] = 1.f, ++set;
      }
      local.backward(d_logits);
      const double backward = local.work() / whole_work - forward;
      std::printf("%-8s %4.0f m: forward 1/%.1f, backward 1/%.1f, both 1/%.1f; %.0f MB kept\n", name, range,
                  1 / forward, 1 / backward, 2 / (forward + backward),
                  static_cast<double>(clean->bytes()) / (1 << 20));
      EXPECT_LT(forward, 0.95) << name;
      EXPECT_LT(backward, 0.8 * forward) << name;
      EXPECT_GT(backward, 0) << name;
    }
  }
}

}  // namespace

// How much of a car continuous fusion lets pixels speak of: cells of the bird's-eye view take their picture
// feature at a return, and a car without returns near its cells would be seen by the picture in vain.
// MIRAGE_KITTI names frames to measure beside the generated ones; both are printed.

namespace {

Rig kitti64() {
  return read_rig(std::filesystem::path(MIRAGE_SOURCE) / "scenes" / "rigs" / "kitti64.toml");
}

/// Counts over the cars that a detector must find.
struct Reach {
  int cars = 0;
  int unseen = 0;        ///< cars without a picture feature in any cell, on any scale
  double cells = 0;      ///< share of a car's 0.5 m cells with a picture feature, summed over cars
  double own_cells = 0;  ///< the same share, with the feature from a return on the car itself

  void add(const Frame& frame);
  void print(const std::string& what) const {
    std::printf(
        "%s: %d cars, of their cells %.1f %% read the picture, %.1f %% at a return on the car itself; "
        "%d cars have none\n",
        what.c_str(), cars, 100 * cells / cars, 100 * own_cells / cars, unseen);
  }
};

/// Whether a place on the ground lies in the box grown by `margin` (m) on all sides.
bool lies_in(const BevBox& box, double x, double y, double margin) {
  return contains(Box3{box, -1, 2}, {x, y, 0}, margin);
}

void Reach::add(const Frame& frame) {
  std::vector<float> points;
  for (const LidarPoint& p : points_in_view(frame.sweep, frame.calibration))
    points.insert(points.end(), {p.x, p.y, p.z, p.reflectance});
  const auto nearest =
      nearest_points(points, pixel_from_velo(frame.calibration), frame.image.width, frame.image.height);
  for (const ObjectBoxes& object : ground_truth(frame, {kXMin, kXMax, kYMin, kYMax}).space.boxes) {
    const BevBox& box = object.box.bev;
    const auto covers = [&](const Grid& grid, std::int64_t cell, double margin) {
      return lies_in(box, cell_x(cell / grid.columns, grid.cell), cell_y(cell % grid.columns, grid.cell),
                     margin);
    };
    bool any = false;
    for (std::size_t level = 0; level < kGrids.size(); ++level)  // a coarse cell covers its whole square
      for (const std::int64_t cell : nearest[level].cells)
        any = any || covers(kGrids[level], cell, kGrids[level].cell / 2);
    const Grid& finest = kGrids[0];
    double all = 0, read = 0, own = 0;
    for (std::int64_t cell = 0; cell < finest.rows * finest.columns; ++cell) all += covers(finest, cell, 0);
    for (std::size_t k = 0; k < nearest[0].cells.size(); ++k) {
      if (!covers(finest, nearest[0].cells[k], 0)) continue;
      const float* point = points.data() + 4 * nearest[0].points[k];
      ++read;
      own += lies_in(box, point[0], point[1], 0.2);
    }
    ++cars;
    unseen += !any;
    cells += read / std::max(1., all);
    own_cells += own / std::max(1., all);
  }
}

TEST(PictureReach, OfGeneratedCars) {
  Reach reach;
  for (const std::uint64_t index : {0u, 1u, 2u, 3u}) reach.add(generate_frame(kitti64(), 3, index));
  reach.print("generated");
  EXPECT_GT(reach.cars, 10);
  EXPECT_EQ(reach.unseen, 0);
  EXPECT_GT(reach.cells, 0.9 * reach.cars);
  EXPECT_GT(reach.own_cells, 0.85 * reach.cars);
  EXPECT_LE(reach.own_cells, reach.cells);
}

TEST(PictureReach, OfRealCars) {
  MIRAGE_NEED_REAL_FRAMES();
  const std::filesystem::path data = test::real_frames();
  Reach reach;
  for (const std::string& id : list_frames(data)) reach.add(read_frame(data, id));
  reach.print(data.string());
  EXPECT_GT(reach.cars, 0);
  EXPECT_LT(reach.unseen, 0.02 * reach.cars + 1);
  EXPECT_GT(reach.cells, 0.9 * reach.cars);
  EXPECT_GT(reach.own_cells, 0.85 * reach.cars);
}

/// The measure itself: a car without returns nearby has no picture feature.
TEST(PictureReach, IsNoneWithoutReturns) {
  Frame frame = generate_frame(kitti64(), 3, 0);
  frame.sweep.clear();
  Reach reach;
  reach.add(frame);
  EXPECT_GT(reach.cars, 0);
  EXPECT_EQ(reach.unseen, reach.cars);
  EXPECT_EQ(reach.cells, 0);
}

}  // namespace
}  // namespace mirage::fusion
