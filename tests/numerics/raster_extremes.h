// How an extreme is judged: the plain loop in double and the fast float path on the same scene.
//
// No NaN or Inf may come out of either, images stay in the range of what was blended, and the float image and
// gradient must be those of a scene whose corners lie within kShift samples and kDepth (relative) of the
// given ones: where the definition jumps (an edge under a sample, two faces at one depth, a texel's border)
// no float program can be closer. The error beyond that is bounded.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>

#include "sensors/raster_batch.h"
#include "support/raster_problem.h"

namespace mirage::test {

inline constexpr double kShift = 5e-5;  ///< samples
inline constexpr double kDepth = 1e-6;
inline constexpr std::size_t kPerturbations = 80;  ///< at most, the last ones four times as large
/// A value that a perturbation changes by more is undefined in float arithmetic; it must only be finite.
inline constexpr double kUndefined = 0.01;

struct Extreme {
  ScreenMesh<double> mesh;
  SoftRasterSettings<double> settings;
  RasterTarget<float> target;
  ImageF upstream;  ///< d loss / d rgba
};

struct Bounds {
  double image = 2e-4;  ///< of I and S
  double gradient =
      1e-3;  ///< relative to the double gradient's largest component or 1, vertices and texels apart
  /// Or this over γ h, h the smallest altitude of a face (at least edge_on_altitude), where that is more:
  /// what z gets is a difference of colours over γ, what x and y get by it has the barycentrics' slope 1/h.
  double color_rounding = 2e-7;
};

/// The compared parts of the gradient. A face thinner than a sample's rounding has no well-defined nearest
/// edge. The gradient's split among its corners is then arbitrary, but its sum over the face is not. `none`:
/// only finite.
enum class Compare { corners, faces, none };

struct Measured {
  bool finite = true;
  double image = 0, image_beyond = 0;  ///< largest difference, and its part that perturbations do not explain
  double gradient = 0, gradient_beyond = 0;  ///< the same, relative
  double excess = 0;                         ///< largest ratio of an error to its bound
  double largest_gradient = 0;               ///< of the double path
  double values = 0, undefined = 0;          ///< number of compared values, and of those undefined in float
};

/// Sets the window to the mesh's pixels within `clip`; random background and upstream gradient.
inline void fit_window(int width, int height, const PixelRect& clip, RandomStream& random, Extreme& extreme) {
  RasterTarget<float>& target = extreme.target;
  target.width = width;
  target.height = height;
  target.rect = touched_pixels(extreme.mesh, extreme.settings, width, height, clip);
  target.background = ImageF(target.rect.width(), target.rect.height(), 3);
  fill_random(target.background, random, 0, 1);
  extreme.upstream = ImageF(target.rect.width(), target.rect.height(), 4);
  fill_random(extreme.upstream, random, -1, 1);
}

struct Drawn {
  std::vector<double> image, vertices, texels;
};

inline Drawn draw_plain(const Extreme& extreme, const RasterTarget<double>& target,
                        const Image<double>& upstream) {
  Drawn drawn;
  drawn.image = rasterize(extreme.mesh, extreme.settings, target).data;
  const auto gradient = rasterize_vjp(extreme.mesh, extreme.settings, target, upstream);
  for (const auto& face : gradient.faces)
    for (const Vec3d& d : face) drawn.vertices.insert(drawn.vertices.end(), d.data(), d.data() + 3);
  append(drawn.texels, gradient.texels);
  return drawn;
}

inline Drawn draw_fast(const Extreme& extreme) {
  const RasterJob job{&extreme.mesh, &extreme.settings, &extreme.target};
  RasterTape tape;
  ScreenGradient<double> gradient;
  rasterize_batch({&job, 1}, {&tape, 1});
  rasterize_batch_vjp({&job, 1}, {&extreme.upstream, 1}, {&tape, 1}, {&gradient, 1});
  Drawn drawn;
  drawn.image.assign(tape.rgba.data.begin(), tape.rgba.data.end());
  for (const auto& face : gradient.faces)
    for (const Vec3d& d : face) drawn.vertices.insert(drawn.vertices.end(), d.data(), d.data() + 3);
  append(drawn.texels, gradient.texels);
  return drawn;
}

inline bool all_finite(const Drawn& drawn) {
  for (const auto* list : {&drawn.image, &drawn.vertices, &drawn.texels})
    for (double value : *list)
      if (!std::isfinite(value)) return false;
  return true;
}

inline double largest(const std::vector<double>& values) {
  double result = 0;
  for (double value : values) result = std::max(result, std::abs(value));
  return result;
}

inline double smallest_altitude(const Extreme& extreme) {
  double smallest = 1;
  for (const auto& face : extreme.mesh.faces) {
    const Vec2d a = (face[1] - face[0]).head<2>(), b = (face[2] - face[0]).head<2>();
    const double altitude =
        std::abs(a.x() * b.y() - a.y() * b.x()) / std::max({a.norm(), b.norm(), (a - b).norm()});
    if (altitude > kNoArea) smallest = std::min(smallest, altitude);
  }
  return std::max(smallest, extreme.settings.edge_on_altitude);
}

/// The mesh with every corner moved at random, within `scale` times the resolution of float arithmetic.
inline Extreme perturbed(const Extreme& extreme, int scale, RandomStream& random) {
  Extreme result = extreme;
  auto& [mesh, settings, target, upstream] = result;
  const double shift = scale * kShift * 2 / (std::max(target.width, target.height) * target.supersampling);
  for (auto& face : mesh.faces)
    for (Vec3d& v : face)
      v = Vec3d{v.x() + random.uniform(-shift, shift), v.y() + random.uniform(-shift, shift),
                v.z() * (1 + scale * random.uniform(-kDepth, kDepth))};
  // Moves the point in the texture, too: on a large face a corner's move changes it by less.
  if (mesh.texture == Texture::atlas && mesh.texel_face.empty()) {
    for (std::size_t f = 0; f < mesh.faces.size(); ++f) mesh.texel_face.push_back(static_cast<int>(f));
    mesh.corner_barycentrics.assign(mesh.faces.size(), {Vec3d::UnitX(), Vec3d::UnitY(), Vec3d::UnitZ()});
  }
  for (auto& corners : mesh.corner_barycentrics)
    for (Vec3d& b : corners)
      for (int c = 0; c < 3; ++c) b[c] += scale * random.uniform(-kShift, kShift);
  // Moves near and far, too, so that a fragment that misses them by rounding may pass.
  const double slack = scale * kDepth * (settings.far - settings.near);
  settings.near = std::max(settings.near / 2, settings.near + random.uniform(-slack, slack));
  settings.far += random.uniform(-slack, slack);
  return result;
}

/// Sums over each face's three corners.
inline void sum_corners(Drawn& drawn) {
  std::vector<double> sums(drawn.vertices.size() / 3, 0.0);
  for (std::size_t i = 0; i < drawn.vertices.size(); ++i) sums[i / 9 * 3 + i % 3] += drawn.vertices[i];
  drawn.vertices = std::move(sums);
}

inline Measured measure(const Extreme& extreme, Compare what = Compare::corners) {
  Measured result;
  const RasterTarget<double> target = to_double(extreme.target);
  const Image<double> upstream = to_double(extreme.upstream);
  Drawn plain = draw_plain(extreme, target, upstream), fast = draw_fast(extreme);
  result.finite = all_finite(plain) && all_finite(fast);
  result.largest_gradient = std::max(largest(plain.vertices), largest(plain.texels));
  if (!result.finite) return result;
  if (what == Compare::faces) {
    sum_corners(plain);
    sum_corners(fast);
  }

  RandomStream random(1, "what float cannot tell apart");
  std::vector<Drawn> nearby;
  const auto compare = [&](std::vector<double> Drawn::*part, double scale, double tolerance, double& worst,
                           double& beyond) {
    for (std::size_t i = 0; i < (plain.*part).size(); ++i) {
      const double error = std::abs((fast.*part)[i] - (plain.*part)[i]) / scale;
      ++result.values;
      worst = std::max(worst, error);
      if (error <= tolerance) {
        beyond = std::max(beyond, error);
        result.excess = std::max(result.excess, error / tolerance);
        continue;
      }
      double explained = 0;
      for (std::size_t k = 0; k < kPerturbations && error - explained > tolerance; ++k) {
        if (k == nearby.size()) {
          nearby.push_back(
              draw_plain(perturbed(extreme, 1 + static_cast<int>(k) / 20, random), target, upstream));
          if (what == Compare::faces) sum_corners(nearby.back());
        }
        explained = std::max(explained, std::abs((nearby[k].*part)[i] - (plain.*part)[i]) / scale);
      }
      if (explained >= kUndefined) {
        ++result.undefined;
        continue;
      }
      beyond = std::max(beyond, error - explained);
      result.excess = std::max(result.excess, (error - explained) / tolerance);
    }
  };
  const Bounds bounds;
  compare(&Drawn::image, 1, bounds.image, result.image, result.image_beyond);
  if (what == Compare::none) return result;
  const double rounding = bounds.color_rounding / (extreme.settings.gamma * smallest_altitude(extreme));
  for (auto part : {&Drawn::vertices, &Drawn::texels}) {
    const double scale = std::max(1.0, largest(plain.*part));
    compare(part, scale, std::max(bounds.gradient, rounding / scale), result.gradient,
            result.gradient_beyond);
  }
  return result;
}

inline Measured worse(const Measured& a, const Measured& b) {
  return {a.finite && b.finite,
          std::max(a.image, b.image),
          std::max(a.image_beyond, b.image_beyond),
          std::max(a.gradient, b.gradient),
          std::max(a.gradient_beyond, b.gradient_beyond),
          std::max(a.excess, b.excess),
          std::max(a.largest_gradient, b.largest_gradient),
          a.values + b.values,
          a.undefined + b.undefined};
}

/// Runs the scene, checks the conditions at the head of this file, and returns the measured values.
inline Measured expect_stable(const Extreme& extreme, Compare what = Compare::corners) {
  const Measured measured = measure(extreme, what);
  EXPECT_TRUE(measured.finite);
  EXPECT_LE(measured.excess, 1) << "image " << measured.image_beyond << ", gradient "
                                << measured.gradient_beyond << " beyond rounding";
  return measured;
}

/// One line for the table of extremes.
inline void report(const char* extreme, const Measured& measured) {
  std::printf(
      "%-28s image %.1e (beyond rounding %.1e), gradient %.1e (%.1e), without value %.0f of %.0f, steepest "
      "%.1e\n",
      extreme, measured.image, measured.image_beyond, measured.gradient, measured.gradient_beyond,
      measured.undefined, measured.values, measured.largest_gradient);
}

}  // namespace mirage::test
