#include "sensors/ray_caster.h"

#include <embree3/rtcore.h>

#include <limits>
#include <string>
#include <utility>

#include "base/error.h"
#include "base/parallel.h"

namespace mirage {
namespace {

constexpr std::size_t kGrain = 2048;

void fail(const std::string& problem) {
  throw Failure("ray caster", problem, "check the memory that is left and the mesh sizes");
}

void check(RTCDevice device) {
  const RTCError code = rtcGetDeviceError(device);
  if (code != RTC_ERROR_NONE) fail("Embree error " + std::to_string(static_cast<int>(code)));
}

RTCRay embree_ray(const Ray& ray) {
  RTCRay r;
  r.org_x = ray.origin.x();
  r.org_y = ray.origin.y();
  r.org_z = ray.origin.z();
  r.dir_x = ray.direction.x();
  r.dir_y = ray.direction.y();
  r.dir_z = ray.direction.z();
  r.tnear = ray.t_min;
  r.tfar = ray.t_max;
  r.time = 0;
  r.mask = ~0u;
  r.id = 0;
  r.flags = 0;
  return r;
}

struct Geometry {
  const float* vertices = nullptr;  // owned by Embree
  const unsigned* faces = nullptr;
};

}  // namespace

struct RayCaster::State {
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
  std::vector<Geometry> geometries;

  State() = default;
  State(const State&) = delete;
  State& operator=(const State&) = delete;
  ~State() {
    if (scene) rtcReleaseScene(scene);
    if (device) rtcReleaseDevice(device);
  }
};

RayCaster::RayCaster(std::span<const Mesh> meshes) : state_(std::make_unique<State>()) {
  // One build thread a device: scenes here are small, and callers already work in parallel.
  state_->device = rtcNewDevice("threads=1,set_affinity=0");
  if (!state_->device)
    fail("Embree device not made (error " + std::to_string(rtcGetDeviceError(nullptr)) + ")");
  state_->scene = rtcNewScene(state_->device);
  if (!state_->scene) check(state_->device);
  rtcSetSceneFlags(state_->scene, RTC_SCENE_FLAG_ROBUST);
  state_->geometries.resize(meshes.size());
  for (std::size_t m = 0; m < meshes.size(); ++m) {
    const Mesh& mesh = meshes[m];
    if (mesh.faces.empty()) continue;
    const RTCGeometry geometry = rtcNewGeometry(state_->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    if (!geometry) check(state_->device);
    auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(
        geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), mesh.vertices.size()));
    auto* faces = static_cast<unsigned*>(rtcSetNewGeometryBuffer(
        geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 3 * sizeof(unsigned), mesh.faces.size()));
    if (!vertices || !faces) {
      rtcReleaseGeometry(geometry);
      check(state_->device);
      fail("no room for " + std::to_string(mesh.faces.size()) + " faces");
    }
    for (std::size_t v = 0; v < mesh.vertices.size(); ++v)
      for (int c = 0; c < 3; ++c) vertices[3 * v + c] = static_cast<float>(mesh.vertices[v][c]);
    for (std::size_t f = 0; f < mesh.faces.size(); ++f)
      for (int c = 0; c < 3; ++c) faces[3 * f + c] = static_cast<unsigned>(mesh.faces[f][c]);
    state_->geometries[m] = {vertices, faces};
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(state_->scene, geometry, static_cast<unsigned>(m));
    rtcReleaseGeometry(geometry);
  }
  rtcCommitScene(state_->scene);
  check(state_->device);
}

RayCaster::~RayCaster() = default;
RayCaster::RayCaster(RayCaster&&) noexcept = default;
RayCaster& RayCaster::operator=(RayCaster&&) noexcept = default;

Hit RayCaster::intersect(const Ray& ray) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRayHit query;
  query.ray = embree_ray(ray);
  query.hit.geomID = query.hit.primID = RTC_INVALID_GEOMETRY_ID;
  query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  rtcIntersect1(state_->scene, &context, &query);
  Hit hit;
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return hit;
  hit.t = query.ray.tfar;
  hit.mesh = static_cast<int>(query.hit.geomID);
  hit.face = static_cast<int>(query.hit.primID);
  hit.b1 = query.hit.u;
  hit.b2 = query.hit.v;
  // From the vertices: Embree's own Ng has changed its sign between major versions.
  const Geometry& g = state_->geometries[hit.mesh];
  const unsigned* f = g.faces + 3 * static_cast<std::size_t>(hit.face);
  const Eigen::Map<const Vec3f> a(g.vertices + 3 * f[0]), b(g.vertices + 3 * f[1]), c(g.vertices + 3 * f[2]);
  hit.normal = (b - a).cross(c - a);
  return hit;
}

void RayCaster::intersect(std::span<const Ray> rays, std::span<Hit> hits) const {
  if (rays.size() != hits.size()) fail("as many hits as rays are needed");
  parallel_for(
      rays.size(), [&](std::size_t i) { hits[i] = intersect(rays[i]); }, kGrain);
}

bool RayCaster::occluded(const Ray& ray) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  RTCRay query = embree_ray(ray);
  rtcOccluded1(state_->scene, &context, &query);
  return query.tfar < 0;  // Embree marks an occluded ray with −∞
}

}  // namespace mirage
