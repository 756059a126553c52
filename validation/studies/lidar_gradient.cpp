// Whether an attack's gradient through the LiDAR says where the objective falls:
//
//     mirage_lidar_gradient_study DATA [DETECTOR [VEHICLES]]
//
// The paper's ellipsoid at 0.6, 0.75 and 0.9 of the box stands on VEHICLES hosts of DATA (96), drawn at
// random. It grows, along all axes and along each, is dented at random and warped by waves. Printed, as means
// over the vehicles: the objective's slope along each motion by the gradient with `--lidar-gradient fixed`
// and `silhouette`, and by differences over ±10 % of the motion; then the correlation of each gradient's
// slopes with the differences, and the mean cosine between two vehicles' gradients. The detector is asked
// through the LiDAR alone.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "attack/adversary.h"
#include "attack/attack_step.h"
#include "base/error.h"
#include "base/random.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

constexpr double kHalfStep = 0.1;

struct Motion {
  const char* name;
  std::vector<Vec3d> of;  ///< one a vertex, m
};

std::vector<Motion> motions(const std::vector<Vec3d>& vertices) {
  constexpr double kDent = 0.4;  // m, at ±100 %
  RandomStream random(9, "motions");
  const auto drawn = [&] {
    return Vec3d(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1));
  };
  std::vector<Motion> all = {{"size", {}}, {"length", {}}, {"width", {}}, {"height", {}}};
  for (const Vec3d& v : vertices) {
    all[0].of.push_back(v);
    for (int c = 0; c < 3; ++c) all[static_cast<std::size_t>(1 + c)].of.push_back(Vec3d::Unit(c) * v[c]);
  }
  for (const char* name : {"dent 1", "dent 2", "dent 3"}) {
    all.push_back({name, {}});
    for (std::size_t i = 0; i < vertices.size(); ++i) all.back().of.push_back(kDent * drawn());
  }
  for (const char* name : {"warp 1", "warp 2", "warp 3"}) {
    all.push_back({name, {}});
    const Vec3d along = 4 * drawn(), to = drawn(), other = drawn();
    for (const Vec3d& v : vertices)
      all.back().of.push_back(kDent * (std::sin(along.dot(v)) * to + std::cos(along.dot(v)) * other));
  }
  return all;
}

double dot(const std::vector<Vec3d>& a, const std::vector<Vec3d>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += a[i].dot(b[i]);
  return sum;
}

/// Of all pairs. Without any: 0.
double mean_cosine(const std::vector<std::vector<Vec3d>>& gradients) {
  double sum = 0;
  int pairs = 0;
  for (std::size_t a = 0; a < gradients.size(); ++a)
    for (std::size_t b = 0; b < a; ++b) {
      const double norms = std::sqrt(dot(gradients[a], gradients[a]) * dot(gradients[b], gradients[b]));
      if (!(norms > 0)) continue;
      sum += dot(gradients[a], gradients[b]) / norms;
      ++pairs;
    }
  return pairs > 0 ? sum / pairs : 0;
}

double correlation(const std::vector<double>& a, const std::vector<double>& b) {
  const auto n = static_cast<double>(a.size());
  double mean_a = 0, mean_b = 0, ab = 0, aa = 0, bb = 0;
  for (std::size_t i = 0; i < a.size(); ++i) mean_a += a[i] / n, mean_b += b[i] / n;
  for (std::size_t i = 0; i < a.size(); ++i) {
    ab += (a[i] - mean_a) * (b[i] - mean_b);
    aa += (a[i] - mean_a) * (a[i] - mean_a), bb += (b[i] - mean_b) * (b[i] - mean_b);
  }
  return ab / std::sqrt(aa * bb);
}

void study(const std::string& data, const std::string& name, std::size_t vehicles) {
  AttackSettings settings;
  settings.data = data;
  settings.detector.detector = name;
  const auto detector = load_detector(settings.detector);
  FrameStore store(settings);
  const auto hosts =
      find_all_hosts(store, list_frames(data), detector->region(), settings.simulation, settings.min_view);
  if (hosts.empty())
    throw InputError(data, "label_2", "no car has enough of its roof in view", "give more frames");
  RandomStream random(3, "vehicles");
  std::vector<Host> sampled;
  for (std::size_t i = 0; i < vehicles; ++i)
    sampled.push_back(hosts[static_cast<std::size_t>(random.uniform() * static_cast<double>(hosts.size()))]);

  CleanSights sights;
  std::array<std::vector<double>, 3> slopes;  // fixed, silhouette, differences
  for (const double share : {0.6, 0.75, 0.9}) {
    const TexturedMesh mesh = initial_adversary(settings.limits, share);
    const std::vector<Motion> all = motions(mesh.mesh.vertices);
    std::vector<std::array<double, 3>> along(all.size(), {0, 0, 0});
    std::array<std::vector<std::vector<Vec3d>>, 2> gradients;
    for (Host host : sampled) {
      const auto prepared = store.get(host.id.frame);
      host.rooftop = store.rooftop(host.id);
      const auto clean = sights.of(*prepared, *detector);
      for (const LidarGradient kind : {LidarGradient::fixed, LidarGradient::silhouette}) {
        settings.simulation.lidar_gradient = kind;
        auto& of_kind = gradients[static_cast<std::size_t>(kind)];
        of_kind.push_back(
            attack_host(*detector, *prepared, host, mesh, AttackTarget::lidar, settings, nullptr, clean)
                .gradient.vertices);
        for (std::size_t m = 0; m < all.size(); ++m)
          along[m][static_cast<std::size_t>(kind)] +=
              dot(of_kind.back(), all[m].of) / static_cast<double>(vehicles);
      }
      for (std::size_t m = 0; m < all.size(); ++m)
        for (const double sign : {1, -1}) {
          TexturedMesh moved = mesh;
          for (std::size_t i = 0; i < all[m].of.size(); ++i)
            moved.mesh.vertices[i] += sign * kHalfStep * all[m].of[i];
          const HostStep judged = judge_host(*detector, *prepared, host, moved, settings, nullptr, clean);
          along[m][2] +=
              sign * (judged.hide + judged.false_positive) / (2 * kHalfStep * static_cast<double>(vehicles));
        }
    }
    std::printf("\n%.2f of the box      fixed  silhouette  differences\n", share);
    for (std::size_t m = 0; m < all.size(); ++m) {
      std::printf("%-14s %10.3f  %10.3f  %11.3f\n", all[m].name, along[m][0], along[m][1], along[m][2]);
      for (std::size_t k = 0; k < 3; ++k) slopes[k].push_back(along[m][k]);
    }
    std::printf("cosine of two  %10.4f  %10.4f\n", mean_cosine(gradients[0]), mean_cosine(gradients[1]));
    std::fflush(stdout);
  }
  std::printf("\n%s, %zu vehicles: correlation with differences, %zu slopes: fixed %.2f, silhouette %.2f\n",
              name.c_str(), vehicles, slopes[2].size(), correlation(slopes[0], slopes[2]),
              correlation(slopes[1], slopes[2]));
}

}  // namespace
}  // namespace mirage

int main(int argc, char** argv) try {
  if (argc < 2) {
    std::fprintf(stderr, "mirage_lidar_gradient_study DATA [DETECTOR [VEHICLES]]\n");
    return 2;
  }
  mirage::study(argv[1], argc > 2 ? argv[2] : "lidar",
                argc > 3 ? static_cast<std::size_t>(std::max(1, std::atoi(argv[3]))) : 96);
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
