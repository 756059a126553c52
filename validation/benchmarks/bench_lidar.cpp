// LiDAR figures. Sweep tracing is compared with a loop written directly against Embree, over the same rays
// and triangles, in alternation within one run: medians, and the ratio of medians.
#include <fmt/format.h>

#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "attack/adversary.h"
#include "base/files.h"
#include "base/parallel.h"
#include "base/random.h"
#include "base/sizes.h"
#include "bench.h"
#include "geometry/mesh.h"
#include "sensors/embree.h"
#include "sensors/lidar_model.h"
#include "sensors/ray_caster.h"
#include "sensors/ray_pencil.h"
#include "simulation/adversary_lidar.h"
#include "simulation/insertion.h"

namespace mirage {
namespace {

constexpr int kSweepRounds = 41;

/// About 200 000 triangles around the sensor: uneven ground and eight boulders of 20 480 faces.
Mesh boulders_on_ground() {
  Mesh scene;
  constexpr int cells = 135;
  constexpr double size = 120;
  for (int i = 0; i <= cells; ++i)
    for (int j = 0; j <= cells; ++j) {
      const double x = size * (double(i) / cells - 0.5), y = size * (double(j) / cells - 0.5);
      scene.vertices.push_back(Vec3d(x, y, -1.73 + 0.1 * std::sin(0.9 * x) * std::cos(0.7 * y)));
    }
  for (int i = 0; i < cells; ++i)
    for (int j = 0; j < cells; ++j) {
      const int a = i * (cells + 1) + j, b = a + cells + 1;
      scene.faces.push_back({a, b, b + 1});
      scene.faces.push_back({a, b + 1, a + 1});
    }
  Mesh boulder = icosphere(5);
  for (Vec3d& v : boulder.vertices)
    v *= 1.5 + 0.15 * std::sin(7 * v.x()) * std::sin(5 * v.y()) * std::cos(6 * v.z());
  for (int k = 0; k < 8; ++k) {
    Transform place = Transform::Identity();
    const double turn = k * std::numbers::pi / 4, away = 6 + 3 * k;
    place.translation() = Vec3d(away * std::cos(turn), away * std::sin(turn), -0.6);
    append(scene, boulder, place);
  }
  return scene;
}

LidarModel full_turn_hdl64() {
  LidarModel lidar = read_lidar_model(shipped_file("scenes/rigs/kitti64.toml"));
  lidar.azimuth_min = -std::numbers::pi;
  lidar.azimuth_max = std::numbers::pi - lidar.azimuth_step;
  return lidar;
}

/// Embree and nothing else: prebuilt arrays of rays in, distance and triangle out.
class BareEmbree {
 public:
  BareEmbree(const Mesh& mesh, const RayTable& rays, bool robust) : rays_(rays) {
    device_ = rtcNewDevice("");
    scene_ = rtcNewScene(device_);
    if (robust) rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
    const RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* v = static_cast<float*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0,
                                                          RTC_FORMAT_FLOAT3, 12, mesh.vertices.size()));
    auto* f = static_cast<unsigned*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, mesh.faces.size()));
    for (const Vec3d& p : mesh.vertices)
      for (int c = 0; c < 3; ++c) *v++ = static_cast<float>(p[c]);
    for (const Face& face : mesh.faces)
      for (int corner : face) *f++ = static_cast<unsigned>(corner);
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene_, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene_);
    t_.resize(rays.rows * rays.stride);
    face_.resize(t_.size());
  }
  ~BareEmbree() {
    rtcReleaseScene(scene_);
    rtcReleaseDevice(device_);
  }
  BareEmbree(const BareEmbree&) = delete;
  BareEmbree& operator=(const BareEmbree&) = delete;

  void trace(float t_min, float t_max) {
    parallel_for(rays_.rows, [&](std::size_t row) {
      EmbreeQuery query(true);
      alignas(64) RTCRayHit16 packet;
      alignas(64) int valid[16];
      for (int i = 0; i < 16; ++i) {
        packet.ray.tnear[i] = t_min;
        packet.ray.time[i] = 0;
        packet.ray.mask[i] = ~0u;
        packet.ray.flags[i] = 0;
        valid[i] = -1;
      }
      for (std::size_t column = 0; column < rays_.columns; column += 16) {
        const std::size_t at = rays_.index(row, column);
        for (std::size_t i = 0; i < 16; ++i) {
          packet.ray.org_x[i] = rays_.origin[0][at + i];
          packet.ray.org_y[i] = rays_.origin[1][at + i];
          packet.ray.org_z[i] = rays_.origin[2][at + i];
          packet.ray.dir_x[i] = rays_.direction[0][at + i];
          packet.ray.dir_y[i] = rays_.direction[1][at + i];
          packet.ray.dir_z[i] = rays_.direction[2][at + i];
          packet.ray.tfar[i] = t_max;
          packet.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
        }
        if (column + 16 > rays_.columns)
          for (std::size_t i = rays_.columns - column; i < 16; ++i) valid[i] = 0;
        query.intersect(valid, scene_, packet);
        for (std::size_t i = 0; i < 16; ++i) {
          t_[at + i] = packet.ray.tfar[i];
          face_[at + i] = packet.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID ? ~0u : packet.hit.primID[i];
        }
      }
    });
  }
  const std::vector<float>& t() const { return t_; }
  const std::vector<unsigned>& face() const { return face_; }

 private:
  const RayTable& rays_;
  RTCDevice device_;
  RTCScene scene_;
  std::vector<float> t_;
  std::vector<unsigned> face_;
};

void lidar_sweep_200k(benchmark::State& state) {
  const LidarModel lidar = full_turn_hdl64();
  const Mesh mesh = boulders_on_ground();
  const RayTable rays = ray_table(lidar);
  const RayCaster caster(std::span(&mesh, 1));
  BareEmbree bare(mesh, rays, true), fast(mesh, rays, false);
  const float t_min = static_cast<float>(lidar.range_min), t_max = static_cast<float>(lidar.range_max);
  HitTable hits;
  Rounds rounds;
  const int threads = static_cast<int>(state.range(0));
  set_thread_count(threads);
  for (auto _ : state)
    for (int round = 0; round < kSweepRounds; ++round) {
      rounds.time("bare", [&] { bare.trace(t_min, t_max); });
      rounds.time("ours", [&] { caster.intersect(rays, t_min, t_max, hits); });
      rounds.time("not robust", [&] { fast.trace(t_min, t_max); });
    }
  set_thread_count(1);
  std::size_t met = 0, differ = 0;
  for (std::size_t row = 0; row < rays.rows; ++row)
    for (std::size_t column = 0; column < rays.columns; ++column) {
      const std::size_t i = rays.index(row, column);
      met += hits.face[i] >= 0;
      differ += static_cast<unsigned>(hits.face[i]) != bare.face()[i];
    }
  const double count = static_cast<double>(rays.rows * rays.columns);
  const std::string suffix = threads == 1 ? "" : fmt::format("_{}_threads", threads);
  auto& all = figures();
  all["lidar_over_bare_embree" + suffix] = rounds["bare"] / rounds["ours"];
  all["lidar_over_bare_embree_not_robust" + suffix] = rounds["not robust"] / rounds["ours"];
  all["lidar_mrays_200k" + suffix] = count / rounds["ours"] / 1e3;
  all["bare_embree_mrays_200k" + suffix] = count / rounds["bare"] / 1e3;
  state.counters["triangles"] = static_cast<double>(mesh.faces.size());
  state.counters["hit_share"] = static_cast<double>(met) / count;
  state.counters["other_face"] = static_cast<double>(differ);
}
ONCE(BENCHMARK(lidar_sweep_200k)->ArgName("threads")->Arg(1)->Arg(2));

/// The adversary's start on a car 10 m ahead; every ray of a whole turn came back from 25 m.
struct LidarStage {
  PreparedFrame prepared;
  TexturedMesh placed;

  LidarStage() {
    prepared.lidar = full_turn_hdl64();
    for (int beam = 0; beam < static_cast<int>(prepared.lidar.beams.size()); ++beam)
      for (int column = 0; column < prepared.lidar.azimuth_count(); ++column) {
        const LidarRay ray = prepared.lidar.ray(beam, column);
        const Vec3f p = (ray.origin + 25 * ray.direction).cast<float>();
        prepared.frame.sweep.push_back({p.x(), p.y(), p.z(), 0.3f});
      }
    prepared.index = SweepIndex(prepared.frame.sweep, prepared.lidar);
    Label host;
    host.box = {{10, 0, 4, 1.7, 0}, -1.73, 1.5};
    placed = place(random_adversary(1), on_roof(BoxRoofFinder().find(prepared.frame, host)));
  }
};

/// The LiDAR's part of one insertion beyond copying the sweep, its VJP, and the sweep's index.
void lidar_insertion(benchmark::State& state) {
  const LidarStage stage;
  const SimulationSettings settings;
  Simulated simulated;
  Sweep copy;
  LidarTape tape;
  Rounds rounds;
  for (auto _ : state)
    for (int round = 0; round < 5 * kSweepRounds; ++round) {
      rounds.time("copy", [&] {
        Sweep fresh;
        fresh.reserve(stage.prepared.frame.sweep.size());
        fresh.insert(fresh.end(), stage.prepared.frame.sweep.begin(), stage.prepared.frame.sweep.end());
        benchmark::DoNotOptimize(fresh.data());
        copy = std::move(fresh);
      });
      rounds.time("lidar_insertion_with_copy_ms", [&] {
        simulated = Simulated();
        tape = draw_in_lidar(stage.prepared, stage.placed, settings, simulated);
      });
      const std::vector<std::array<float, 4>> d_points(simulated.sweep.size(), {1, 1, 1, 1});
      std::vector<Vec3d> d_vertices(stage.placed.mesh.vertices.size(), Vec3d::Zero()), d_texels;
      rounds.time("lidar_insertion_vjp_ms",
                  [&] { draw_in_lidar_vjp(tape, stage.placed, settings, d_points, d_vertices, d_texels); });
      benchmark::DoNotOptimize(d_vertices.data());
      if (round % 10 == 0)
        rounds.time("sweep_index_ms", [&] {
          benchmark::DoNotOptimize(SweepIndex(stage.prepared.frame.sweep, stage.prepared.lidar));
        });
    }
  for (const char* name : {"lidar_insertion_with_copy_ms", "lidar_insertion_vjp_ms", "sweep_index_ms"})
    figures()[name] = rounds[name];
  figures()["lidar_insertion_ms"] = rounds["lidar_insertion_with_copy_ms"] - rounds["copy"];
  figures()["lidar_insertion_returns"] = tape.returns.size();
}
ONCE(BENCHMARK(lidar_insertion));

// Rays of one pencil against Embree's packets: the rays of a light on an object, those of one direction
// together, in alternation within one run.

constexpr int kPencilRounds = 21, kDirections = 32;
constexpr std::size_t kRays = 250;  // along each direction

/// With an icosphere's faces, crumpled.
void ray_pencil(benchmark::State& state) {
  RandomStream random(1, "bench pencil");
  Mesh mesh = icosphere(static_cast<int>(state.range(0)));
  for (Vec3d& v : mesh.vertices) v *= random.uniform(0.3, 1);
  std::vector<Vec3f> directions, starts;
  for (int k = 0; k < kDirections; ++k)
    directions.push_back(Vec3f{static_cast<float>(random.uniform(-1, 1)),
                               static_cast<float>(random.uniform(-1, 1)),
                               static_cast<float>(random.uniform(-1, 1))});
  for (std::size_t i = 0; i < kRays; ++i) {
    const Face& face = mesh.faces[i * mesh.faces.size() / kRays];
    const auto corner = [&](int k) { return mesh.vertices[as_size(face[as_size(k)])]; };
    starts.push_back(((corner(0) + corner(1) + corner(2)) * (1.0001 / 3)).cast<float>());
  }
  Rounds rounds;
  for (auto _ : state)
    for (int round = 0; round < kPencilRounds; ++round) {
      rounds.time("embree", [&] {
        const RayCaster caster(std::span(&mesh, 1));
        RayTable rays(1, kRays * kDirections);
        for (std::size_t i = 0; i < rays.columns; ++i)
          rays.set(0, i, starts[i % kRays], directions[i / kRays]);
        HitTable hits;
        caster.intersect(rays, 0, 1e30f, hits);
        benchmark::DoNotOptimize(hits.face.data());
      });
      rounds.time("pencil", [&] {
        RayPencil rays(mesh, Vec3d::Zero());
        std::vector<RayPencil::Met> met(kRays);
        for (const Vec3f& direction : directions) {
          rays.along(direction);
          rays.intersect(starts, met);
          benchmark::DoNotOptimize(met.data());
        }
      });
    }
  const double per_ray = 1e6 / (static_cast<double>(kRays) * kDirections);
  figures()[fmt::format("ray_pencil_{}_faces_ns", mesh.faces.size())] = per_ray * rounds["pencil"];
  figures()[fmt::format("embree_over_pencil_{}_faces", mesh.faces.size())] =
      rounds["embree"] / rounds["pencil"];
}
ONCE(BENCHMARK(ray_pencil)->Arg(2)->Arg(3)->Arg(4));

}  // namespace
}  // namespace mirage
