#include "attack/mesh_modes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "geometry/texel_grid.h"

namespace mirage {
namespace {

constexpr int kDegree = 2;
/// What a search draws at first, as standard deviations: of log sizes, of displacements in half lengths of
/// the box, of colours' logits.
constexpr double kSize = 0.2, kWarp = 0.2, kColour = 1.5;
/// So that the colours of a black or white start have a logit.
constexpr double kLeastColour = 1e-3;

/// Legendre polynomials of degree 0 … kDegree.
std::array<double, kDegree + 1> legendre(double t) {
  std::array<double, kDegree + 1> p{1, t};
  for (int n = 1; n < kDegree; ++n) {
    const auto i = static_cast<std::size_t>(n);
    p[i + 1] = ((2 * n + 1) * t * p[i] - n * p[i - 1]) / (n + 1);
  }
  return p;
}

enum class Axis { x, y, z, colour };

/// Products of total degree ≤ kDegree: along y odd in y, else even; without the one that stretches the axis.
std::vector<double> modes(const Vec3d& u, Axis axis) {
  const auto px = legendre(u.x()), py = legendre(u.y()), pz = legendre(u.z());
  std::vector<double> values;
  for (std::size_t j = axis == Axis::y ? 1 : 0; j <= kDegree; j += 2)
    for (std::size_t i = 0; i + j <= kDegree; ++i)
      for (std::size_t k = 0; i + j + k <= kDegree; ++k) {
        const bool linear = i + j + k == 1;
        if (linear && ((axis == Axis::x && i == 1) || axis == Axis::y || (axis == Axis::z && k == 1)))
          continue;
        values.push_back(px[i] * py[j] * pz[k]);
      }
  return values;
}

}  // namespace

MeshModes::MeshModes(const TexturedMesh& start, const AdversaryLimits& limits, AttackParts parts,
                     bool texture)
    : start_(start),
      limits_(limits),
      sizes_(parts != AttackParts::texture),
      warps_(parts == AttackParts::both || parts == AttackParts::shape),
      paints_(texture && (parts == AttackParts::both || parts == AttackParts::texture)) {
  const auto count = [](Axis axis) { return modes(Vec3d::Zero(), axis).size(); };
  size_ = (sizes_ ? 3 : 0) + (warps_ ? count(Axis::x) + count(Axis::y) + count(Axis::z) : 0) +
          (paints_ ? 3 * count(Axis::colour) : 0);
  const auto& vertices = start.mesh.vertices;
  const auto place = [&](const Vec3d& v) { return v.cwiseQuotient(limits.half).eval(); };
  for (const Vec3d& v : vertices)
    warp_.push_back({modes(place(v), Axis::x), modes(place(v), Axis::y), modes(place(v), Axis::z)});
  paint_.resize(start.atlas.texels.size());
  const auto triangles = atlas_triangles(start.atlas.resolution);
  for (std::size_t f = 0; f < start.mesh.faces.size(); ++f)
    for (const AtlasTriangle& triangle : triangles) {
      const Vec2d b = (triangle.corners[0] + triangle.corners[1] + triangle.corners[2]) / 3;
      const Face& face = start.mesh.faces[f];
      const auto corner = [&](std::size_t c) { return vertices[static_cast<std::size_t>(face[c])]; };
      const Vec3d centre = b[0] * corner(0) + b[1] * corner(1) + (1 - b[0] - b[1]) * corner(2);
      paint_[f * start.atlas.per_face() + static_cast<std::size_t>(triangle.texel)] =
          modes(place(centre), Axis::colour);
    }
}

TexturedMesh MeshModes::mesh(std::span<const double> numbers) const {
  TexturedMesh made = start_;
  auto at = numbers.begin();
  const auto sum = [](std::span<const double>::iterator from, const std::vector<double>& values) {
    return std::inner_product(values.begin(), values.end(), from, 0.0);
  };
  if (sizes_) {
    const Vec3d scale(std::exp(kSize * at[0]), std::exp(kSize * at[1]), std::exp(kSize * at[2]));
    for (Vec3d& v : made.mesh.vertices) v = v.cwiseProduct(scale);
    at += 3;
  }
  if (warps_)
    for (int c = 0; c < 3; ++c) {
      const auto axis = static_cast<std::size_t>(c);
      for (std::size_t i = 0; i < warp_.size(); ++i)
        made.mesh.vertices[i][c] += kWarp * limits_.half[c] * sum(at, warp_[i][axis]);
      at += std::ssize(warp_.front()[axis]);
    }
  if (paints_)
    for (int c = 0; c < 3; ++c) {
      for (std::size_t i = 0; i < paint_.size(); ++i) {
        double& colour = made.atlas.texels[i][c];
        const double start = std::clamp(colour, kLeastColour, 1 - kLeastColour);
        colour = 1 / (1 + std::exp(-kColour * sum(at, paint_[i])) * (1 - start) / start);
      }
      at += std::ssize(paint_.front());
    }
  project(made, limits_);
  return made;
}

}  // namespace mirage
