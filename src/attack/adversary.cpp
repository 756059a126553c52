#include "attack/adversary.h"

#include <fmt/format.h>

#include <cmath>

#include "base/random.h"

namespace mirage {

void set_from_text(const std::string& text, AdversaryLimits& value) {
  value = limits_of_size(parse_number(text, "limits"));
}

std::string text_of(const AdversaryLimits& value) {
  return value.is_explicit ? fmt::format("{}", value.half.x()) : "the placement's volume";
}

AdversaryLimits limits_of_size(double size) {
  AdversaryLimits limits;
  limits.half *= size / limits.half.x();
  limits.is_explicit = true;
  return limits;
}

TexturedMesh initial_adversary(const AdversaryLimits& limits, double share) {
  return grey_ellipsoid(limits.half, share);
}

TexturedMesh random_adversary(std::uint64_t seed, const AdversaryLimits& limits, double amplitude) {
  TexturedMesh adversary = initial_adversary(limits);
  RandomStream random(seed, "random adversary");
  for (Vec3d& v : adversary.mesh.vertices)
    for (int c = 0; c < 3; ++c) v[c] += random.uniform(-amplitude, amplitude);
  for (Vec3d& t : adversary.atlas.texels)
    for (int c = 0; c < 3; ++c) t[c] = random.uniform();
  project(adversary, limits);
  return adversary;
}

void project(TexturedMesh& adversary, const AdversaryLimits& limits) {
  for (Vec3d& v : adversary.mesh.vertices) v = v.cwiseMax(-limits.half).cwiseMin(limits.half);
  for (Vec3d& t : adversary.atlas.texels) t = t.cwiseMax(0.0).cwiseMin(1.0);
}

Vec3d half_lengths(const Mesh& mesh) {
  Vec3d half = Vec3d::Zero();
  for (const std::size_t i : used_vertices(mesh)) half = half.cwiseMax(mesh.vertices[i].cwiseAbs());
  return half;
}

Vec3d half_length_gradient(const std::vector<Vec3d>& unit, const std::vector<Vec3d>& d_vertices) {
  Vec3d gradient = Vec3d::Zero();
  for (std::size_t i = 0; i < unit.size(); ++i) gradient += unit[i].cwiseProduct(d_vertices[i]);
  return gradient;
}

void Adam::step(std::vector<Vec3d>& values, const std::vector<Vec3d>& gradient) {
  first.resize(3 * values.size());
  second.resize(3 * values.size());
  ++step_count;
  const double scale1 = 1 - std::pow(beta1, step_count), scale2 = 1 - std::pow(beta2, step_count);
  for (std::size_t i = 0; i < values.size(); ++i)
    for (int c = 0; c < 3; ++c) {
      double &m = first[3 * i + as_size(c)], &v = second[3 * i + as_size(c)];
      const double g = gradient[i][c];
      m = beta1 * m + (1 - beta1) * g;
      v = beta2 * v + (1 - beta2) * g * g;
      values[i][c] -= learning_rate * (m / scale1) / (std::sqrt(v / scale2) + epsilon);
    }
}

}  // namespace mirage
