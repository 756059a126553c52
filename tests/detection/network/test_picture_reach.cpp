// How much of a car continuous fusion lets pixels speak of: cells of the bird's-eye view take their picture
// feature at a return, and a car without returns near its cells would be seen by the picture in vain.
// MIRAGE_KITTI names frames to measure beside the generated ones; both are printed.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>

#include "detection/average_precision.h"
#include "detection/points_in_view.h"
#include "generator/generator.h"
#include "geometry/box.h"
#include "nearest.h"
#include "scene/data/read_frames.h"
#include "support/files.h"

namespace mirage::fusion {
namespace {

Rig kitti64() {
  return read_rig(std::filesystem::path(MIRAGE_SOURCE) / "scenes" / "rigs" / "kitti64.toml");
}

/// Over the cars that a detector must find.
struct Reach {
  int cars = 0;
  int unseen = 0;        ///< none of whose cells has a picture feature, on any scale
  double cells = 0;      ///< shares of a car's cells of 0.5 m that have one, summed over cars
  double own_cells = 0;  ///< that have it at a return on the car itself

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
    for (std::size_t level = 0; level < kGrids.size();
         ++level)  // a coarse cell speaks of what its square touches
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
  for (const std::uint64_t index : {0, 1, 2, 3}) reach.add(generate_frame(kitti64(), 3, index));
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

/// The instrument sees a car that no return stands near.
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
