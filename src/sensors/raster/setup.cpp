#include "sensors/raster/setup.h"

#include <algorithm>
#include <cmath>

#include "base/error.h"
#include "base/sizes.h"

namespace mirage::raster {
namespace {

/// False for a face that draws nothing: not finite, behind the camera, or without area.
bool set_up_face(const std::array<Vec3<double>, 3>& corners, const SoftRasterSettings<double>& settings,
                 const RasterTarget<float>& target, const Setup& setup, FaceSetup& face) {
  for (const auto& corner : corners)
    if (!corner.allFinite() || !(corner.z() > 0)) return false;
  const double scale = setup.samples_per_ndc;
  const double width = double(target.supersampling) * target.width,
               height = double(target.supersampling) * target.height;
  for (std::size_t k = 0; k < 3; ++k) {
    face.x[k] = corners[k].x() * scale + (width - 1) / 2;
    face.y[k] = (height - 1) / 2 - corners[k].y() * scale;
  }
  const double* x = face.x;
  const double* y = face.y;
  const double twice_area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0]);
  double longest = 0, lengths[3];
  for (int k = 0; k < 3; ++k) {
    const int next = (k + 1) % 3;
    lengths[k] = std::hypot(x[next] - x[k], y[next] - y[k]);
    longest = std::max(longest, lengths[k]);
  }
  if (!(longest > 0)) return false;
  const double altitude = std::abs(twice_area) / longest;
  if (!(altitude > kNoArea * scale)) return false;
  const double inside = twice_area > 0 ? 1 : -1;
  for (int k = 0; k < 3; ++k) {
    const int next = (k + 1) % 3;
    // A face with area has no edge of length 0.
    face.ex[k] = (x[next] - x[k]) / lengths[k];
    face.ey[k] = (y[next] - y[k]) / lengths[k];
    face.nx[k] = -inside * face.ey[k];
    face.ny[k] = inside * face.ex[k];
    face.length[k] = static_cast<float>(lengths[k]);
    face.inv_length[k] = static_cast<float>(1 / lengths[k]);
    face.inv_altitude[k] = static_cast<float>(lengths[next] / std::abs(twice_area));
  }
  const double reach = setup.reach;
  face.low_x = std::min({x[0], x[1], x[2]}) - reach;
  face.high_x = std::max({x[0], x[1], x[2]}) + reach;
  face.low_y = std::min({y[0], y[1], y[2]}) - reach;
  face.high_y = std::max({y[0], y[1], y[2]}) + reach;
  face.slope_bound = std::min(1.0, altitude / scale / settings.edge_on_altitude);
  // y points down here, up in NDC: the sign of the area flips.
  const bool counter_clockwise = twice_area < 0;
  face.colored =
      settings.sides == Sides::both || (settings.sides == Sides::counter_clockwise) == counter_clockwise;
  return true;
}

/// Tiles that the face's grown bounding box meets: [first, last] by column or row.
bool tile_range(double low, double high, double origin, double side, int count, int& first, int& last) {
  if (!(high >= origin) || !(low <= origin + side * count - 1)) return false;
  first = static_cast<int>(std::max(0.0, std::floor((low - origin) / side)));
  last = static_cast<int>(std::min(count - 1.0, std::floor((high - origin) / side)));
  return first <= last;
}

}  // namespace

void check_settings(const SoftRasterSettings<double>& s) {
  const auto demand = [](bool good, const char* field, const char* problem, const char* fix) {
    if (!good) throw InputError("soft rasteriser", field, problem, fix);
  };
  const auto positive = [](double value) { return value > 0 && std::isfinite(value); };
  demand(positive(s.sigma), "sigma", "is not a positive number", "give NDC², for instance 5e-7");
  demand(positive(s.gamma), "gamma", "is not a positive number",
         "give a share of the depth range, e.g. 1e-2");
  demand(std::isfinite(s.epsilon), "epsilon", "is not a number", "give the background's logit, e.g. 1e-3");
  demand(s.dist_eps > 0 && s.dist_eps < 0.5, "dist_eps", "is not between 0 and 0.5", "give e.g. 1e-4");
  demand(positive(s.near) && std::isfinite(s.far) && s.far > s.near, "near, far", "are not 0 < near < far",
         "give the object's depth range in metres");
  demand(positive(s.edge_on_altitude), "edge_on_altitude", "is not a positive number", "give e.g. 1e-6");
}

void set_up(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
            const RasterTarget<float>& target, Setup& setup) {
  check_settings(settings);
  const int s = target.supersampling;
  if (s < 1 || s > kTile)
    throw InputError("soft rasteriser", "supersampling", "is not between 1 and " + std::to_string(kTile),
                     "give the samples a pixel along one side");
  setup.samples_per_ndc = double(s) * std::max(target.width, target.height) / 2;
  setup.depth_range = settings.far - settings.near;
  setup.reach = std::sqrt(cut_off(settings)) * setup.samples_per_ndc;

  double nearest = settings.far, farthest = settings.near;
  for (const auto& face : mesh.faces)
    for (const auto& corner : face)
      if (corner.z() > 0 && std::isfinite(corner.z())) {
        nearest = std::min(nearest, corner.z());
        farthest = std::max(farthest, corner.z());
      }
  setup.nearest = nearest, setup.farthest = farthest;
  setup.middle = (nearest + farthest) / 2;

  setup.unsorted.clear();
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    FaceSetup face;
    if (!set_up_face(mesh.faces[f], settings, target, setup, face)) continue;
    face.face = static_cast<int>(f);
    double z_front = mesh.faces[f][0].z();
    for (std::size_t k = 0; k < 3; ++k) {
      face.delta[k] = static_cast<float>((setup.middle - mesh.faces[f][k].z()) / mesh.faces[f][k].z());
      z_front = std::min(z_front, mesh.faces[f][k].z());
    }
    face.front = static_cast<float>((setup.middle - z_front) / setup.depth_range);
    setup.unsorted.push_back(face);
  }
  const auto count = setup.unsorted.size();
  setup.order.resize(count);
  for (std::size_t i = 0; i < count; ++i) setup.order[i] = static_cast<std::uint32_t>(i);
  std::sort(setup.order.begin(), setup.order.end(), [&](std::uint32_t a, std::uint32_t b) {
    const float za = setup.unsorted[a].front, zb = setup.unsorted[b].front;
    return za != zb ? za > zb : a < b;
  });
  setup.faces.clear();
  for (std::uint32_t i : setup.order) setup.faces.push_back(setup.unsorted[i]);

  setup.tile_pixels = std::max(1, kTile / s);
  setup.columns = (target.rect.width() + setup.tile_pixels - 1) / setup.tile_pixels;
  setup.rows = (target.rect.height() + setup.tile_pixels - 1) / setup.tile_pixels;
  const double side = double(setup.tile_pixels) * s, x0 = double(s) * target.rect.u0,
               y0 = double(s) * target.rect.v0;
  const auto tiles = as_size(setup.columns) * as_size(setup.rows);
  // Half a tile's diagonal: a tile whose centre is further outside an edge's line than this and the reach
  // holds no sample of the face.
  const double radius = (side - 1) / 2 * std::sqrt(2.0) + setup.reach;
  const auto for_each_tile = [&](const FaceSetup& face, const auto& visit) {
    int c0, c1, r0, r1;
    if (!tile_range(face.low_x, face.high_x, x0, side, setup.columns, c0, c1) ||
        !tile_range(face.low_y, face.high_y, y0, side, setup.rows, r0, r1))
      return;
    for (int r = r0; r <= r1; ++r)
      for (int c = c0; c <= c1; ++c) {
        const double x = x0 + c * side + (side - 1) / 2, y = y0 + r * side + (side - 1) / 2;
        bool far = false;
        for (int k = 0; k < 3; ++k)
          far |= face.nx[k] * (x - face.x[k]) + face.ny[k] * (y - face.y[k]) < -radius;
        if (!far) visit(as_size(r) * as_size(setup.columns) + as_size(c));
      }
  };
  setup.first.assign(tiles + 1, 0);
  for (const FaceSetup& face : setup.faces) for_each_tile(face, [&](std::size_t t) { ++setup.first[t + 1]; });
  for (std::size_t t = 0; t < tiles; ++t) setup.first[t + 1] += setup.first[t];
  setup.binned.resize(as_size(setup.first[tiles]));
  setup.cursor.assign(setup.first.begin(), setup.first.end());
  for (std::size_t f = 0; f < setup.faces.size(); ++f)
    for_each_tile(setup.faces[f], [&](std::size_t t) {
      setup.binned[as_size(setup.cursor[t]++)] = static_cast<std::uint32_t>(f);
    });
}

void add_face_gradient(const Setup& setup, const FaceSetup& face, const FaceGradientSums& sums,
                       std::array<Vec3<double>, 3>& d_face) {
  for (std::size_t k = 0; k < 3; ++k) {
    const double ratio = 1 + static_cast<double>(face.delta[k]);  // middle / z_k
    d_face[k].x() += sums.x[k] * setup.samples_per_ndc;
    d_face[k].y() -= sums.y[k] * setup.samples_per_ndc;  // y points up in NDC
    d_face[k].z() -= sums.delta[k] * ratio * ratio / setup.middle;
  }
}

}  // namespace mirage::raster
