#include "sensors/ray_caster.h"

#include <tbb/task_arena.h>

#include <cstring>
#include <limits>
#include <string>
#include <type_traits>

#include "base/error.h"
#include "base/parallel.h"
#include "base/sizes.h"
#include "sensors/embree.h"

namespace mirage {

/// A mesh's triangles, held and owned by Embree; null if it is out of memory.
struct EmbreeTriangles {
  float* vertices = nullptr;
  unsigned* faces = nullptr;
  bool complete() const { return vertices && faces; }
};

namespace {

constexpr std::size_t kGrain = 2048;

void fail(const std::string& problem) {
  throw Failure("ray caster", problem, "check the memory that is left and the mesh sizes");
}

void check(RTCDevice device) {
  const RTCError code = rtcGetDeviceError(device);
  if (code != RTC_ERROR_NONE) fail("Embree error " + std::to_string(static_cast<int>(code)));
}

/// One device for the process, never released: making one costs more than a small scene. It must not be told
/// its number of threads: Embree's oneTBB build would bound every parallel loop of the process by it.
RTCDevice shared_device() {
  static const RTCDevice device = rtcNewDevice("set_affinity=0");
  if (!device) fail("Embree device not made (error " + std::to_string(rtcGetDeviceError(nullptr)) + ")");
  return device;
}

void check_geometry(const Mesh& mesh, std::size_t index) {
  const auto refuse = [&](const std::string& field, const std::string& problem) {
    throw InputError("mesh " + std::to_string(index), field, problem, "mend the mesh before it is traced");
  };
  for (std::size_t v = 0; v < mesh.vertices.size(); ++v)
    if (!mesh.vertices[v].allFinite()) refuse("vertex " + std::to_string(v), "is not finite");
  const int count = static_cast<int>(mesh.vertices.size());
  for (std::size_t f = 0; f < mesh.faces.size(); ++f)
    for (int corner : mesh.faces[f])
      if (corner < 0 || corner >= count)
        refuse("face " + std::to_string(f), "names a vertex that does not exist");
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

template <int N>
using RayHitN = std::conditional_t<N == 16, RTCRayHit16, std::conditional_t<N == 8, RTCRayHit8, RTCRayHit4>>;

/// Traces one row of a table in packets of N consecutive rays.
template <int N>
void trace_row(RTCScene scene, const RayTable& rays, std::size_t row, float t_min, float t_max,
               HitTable& hits) {
  EmbreeQuery query(true);
  alignas(64) RayHitN<N> packet;
  alignas(64) int valid[as_size(N)];
  for (int i = 0; i < N; ++i) {
    packet.ray.tnear[i] = t_min;
    packet.ray.time[i] = 0;
    packet.ray.mask[i] = ~0u;
    packet.ray.id[i] = 0;
    packet.ray.flags[i] = 0;
  }
  for (std::size_t column = 0; column < rays.columns; column += N) {
    const std::size_t at = rays.index(row, column);
    constexpr std::size_t bytes = N * sizeof(float);
    std::memcpy(packet.ray.org_x, &rays.origin[0][at], bytes);
    std::memcpy(packet.ray.org_y, &rays.origin[1][at], bytes);
    std::memcpy(packet.ray.org_z, &rays.origin[2][at], bytes);
    std::memcpy(packet.ray.dir_x, &rays.direction[0][at], bytes);
    std::memcpy(packet.ray.dir_y, &rays.direction[1][at], bytes);
    std::memcpy(packet.ray.dir_z, &rays.direction[2][at], bytes);
    for (int i = 0; i < N; ++i) {
      packet.hit.geomID[i] = packet.hit.primID[i] = RTC_INVALID_GEOMETRY_ID;
      packet.hit.u[i] = packet.hit.v[i] = 0;
      // One ray that is not finite would spoil the common bounds of its packet: x · 0 is 0 only where x is
      // finite.
      const auto& r = packet.ray;
      const float zero =
          (r.org_x[i] + r.org_y[i] + r.org_z[i]) * 0 + (r.dir_x[i] + r.dir_y[i] + r.dir_z[i]) * 0;
      const bool traced = zero == 0 && column + as_size(i) < rays.columns;
      valid[i] = traced ? -1 : 0;
      // On a processor without packets of N, Embree splits them and reads only the interval, not the mask.
      packet.ray.tfar[i] = traced ? t_max : -1;
    }
    query.intersect(valid, scene, packet);
    for (int i = 0; i < N; ++i)
      if (packet.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID) packet.ray.tfar[i] = -1;
    static_assert(RTC_INVALID_GEOMETRY_ID == ~0u);  // −1 as int
    std::memcpy(&hits.t[at], packet.ray.tfar, bytes);
    std::memcpy(&hits.b1[at], packet.hit.u, bytes);
    std::memcpy(&hits.b2[at], packet.hit.v, bytes);
    std::memcpy(&hits.mesh[at], packet.hit.geomID, bytes);
    std::memcpy(&hits.face[at], packet.hit.primID, bytes);
  }
}

/// Adds the mesh, relative to `origin`, to the scene under that number.
EmbreeTriangles attach(RTCDevice device, RTCScene scene, unsigned number, const Mesh& mesh,
                       const Vec3d& origin) {
  const RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  if (!geometry) return {};
  const EmbreeTriangles own{
      static_cast<float*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                  3 * sizeof(float), mesh.vertices.size())),
      static_cast<unsigned*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                     3 * sizeof(unsigned), mesh.faces.size()))};
  if (own.complete()) {
    for (std::size_t v = 0; v < mesh.vertices.size(); ++v)
      for (int c = 0; c < 3; ++c)
        own.vertices[3 * v + as_size(c)] = static_cast<float>(mesh.vertices[v][c] - origin[c]);
    for (std::size_t f = 0; f < mesh.faces.size(); ++f)
      for (std::size_t c = 0; c < 3; ++c) own.faces[3 * f + c] = static_cast<unsigned>(mesh.faces[f][c]);
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(scene, geometry, number);
  }
  rtcReleaseGeometry(geometry);
  return own;
}

/// Nearest point of a triangle (Ericson, Real-Time Collision Detection, section 5.1.5).
Vec3d nearest_on(const Vec3d& a, const Vec3d& b, const Vec3d& c, const Vec3d& p) {
  const Vec3d ab = b - a, ac = c - a, ap = p - a;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0 && d2 <= 0) return a;
  const Vec3d bp = p - b;
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0 && d4 <= d3) return b;
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return a + (d1 == d3 ? 0 : d1 / (d1 - d3)) * ab;
  const Vec3d cp = p - c;
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0 && d5 <= d6) return c;
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return a + (d2 == d6 ? 0 : d2 / (d2 - d6)) * ac;
  const double va = d3 * d6 - d5 * d4;
  const double e = d4 - d3, f = d5 - d6;
  if (va <= 0 && e >= 0 && f >= 0) return b + (e + f == 0 ? 0 : e / (e + f)) * (c - b);
  const double sum = va + vb + vc;
  return a + vb / sum * ab + vc / sum * ac;
}

struct Query {
  const Mesh* mesh;
  Vec3d p;
  double nearest;
};

bool visit(RTCPointQueryFunctionArguments* arguments) {
  Query& query = *static_cast<Query*>(arguments->userPtr);
  const Face& f = query.mesh->faces[arguments->primID];
  const auto& v = query.mesh->vertices;
  const double d =
      (nearest_on(v[as_size(f[0])], v[as_size(f[1])], v[as_size(f[2])], query.p) - query.p).norm();
  if (d >= query.nearest) return false;
  query.nearest = d;
  // A little more than d: the box tests are in single precision.
  arguments->query->radius = static_cast<float>(d * (1 + 1e-6) + 1e-7);
  return true;
}

// One device for all meshes: a device takes some 30 MB, and a shape model is learnt from hundreds of meshes.
RTCDevice distance_device() {
  static const struct Device {
    RTCDevice device = rtcNewDevice("threads=1");
    ~Device() { rtcReleaseDevice(device); }
  } owner;
  return owner.device;
}

}  // namespace

struct RayCaster::State {
  RTCScene scene = nullptr;
  int width = 1;                           ///< widest packet that the processor traces natively
  std::vector<EmbreeTriangles> triangles;  ///< of each mesh

  State() = default;
  State(const State&) = delete;
  State& operator=(const State&) = delete;
  ~State() {
    if (scene) rtcReleaseScene(scene);
  }
};

RayCaster::RayCaster(std::span<const Mesh> meshes, const Vec3d& origin) : state_(std::make_unique<State>()) {
  const RTCDevice device = shared_device();
  state_->width = rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED)  ? 16
                  : rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_NATIVE_RAY8_SUPPORTED) ? 8
                  : rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_NATIVE_RAY4_SUPPORTED) ? 4
                                                                                            : 1;
  state_->scene = rtcNewScene(device);
  if (!state_->scene) check(device);
  rtcSetSceneFlags(state_->scene, RTC_SCENE_FLAG_ROBUST);
  state_->triangles.resize(meshes.size());
  for (std::size_t m = 0; m < meshes.size(); ++m) {
    const Mesh& mesh = meshes[m];
    check_geometry(mesh, m);
    if (mesh.faces.empty()) continue;
    state_->triangles[m] = attach(device, state_->scene, static_cast<unsigned>(m), mesh, origin);
    if (state_->triangles[m].complete()) continue;
    check(device);
    fail("no room for " + std::to_string(mesh.faces.size()) + " faces");
  }
  // Built by one thread: the tree, and with it which of two faces a ray through their common edge meets, must
  // not depend on the thread count.
  tbb::task_arena alone(1);
  alone.execute([&] { rtcCommitScene(state_->scene); });
  check(device);
}

RayCaster::~RayCaster() = default;
RayCaster::RayCaster(RayCaster&&) noexcept = default;
RayCaster& RayCaster::operator=(RayCaster&&) noexcept = default;

Hit RayCaster::intersect(const Ray& ray) const {
  if (!ray.origin.allFinite() || !ray.direction.allFinite()) return {};
  RTCRayHit query;
  query.ray = embree_ray(ray);
  query.hit.geomID = query.hit.primID = RTC_INVALID_GEOMETRY_ID;
  query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  EmbreeQuery().intersect(state_->scene, query);
  Hit hit;
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return hit;
  hit.t = query.ray.tfar;
  hit.mesh = static_cast<int>(query.hit.geomID);
  hit.face = static_cast<int>(query.hit.primID);
  hit.b1 = query.hit.u;
  hit.b2 = query.hit.v;
  hit.normal = normal(hit.mesh, hit.face);
  return hit;
}

Vec3f RayCaster::normal(int mesh, int face) const {
  // From the vertices: Embree's own Ng has changed its sign between major versions.
  const EmbreeTriangles& g = state_->triangles[as_size(mesh)];
  const unsigned* f = g.faces + 3 * as_size(face);
  const Eigen::Map<const Vec3f> a(g.vertices + 3 * f[0]), b(g.vertices + 3 * f[1]), c(g.vertices + 3 * f[2]);
  return (b - a).cross(c - a);
}

void RayCaster::intersect(std::span<const Ray> rays, std::span<Hit> hits) const {
  if (rays.size() != hits.size()) fail("as many hits as rays are needed");
  parallel_for(
      rays.size(), [&](std::size_t i) { hits[i] = intersect(rays[i]); }, kGrain);
}

RayTable::RayTable(std::size_t rows_, std::size_t columns_)
    : rows(rows_), columns(columns_), stride((columns_ + kPacket - 1) / kPacket * kPacket) {
  for (auto& component : origin) component.resize(rows * stride);
  for (auto& component : direction) component.resize(rows * stride);
}

void RayCaster::intersect(const RayTable& rays, float t_min, float t_max, HitTable& hits, int width) const {
  const std::size_t count = rays.rows * rays.stride;
  for (auto* values : {&hits.t, &hits.b1, &hits.b2}) values->resize(count);
  for (auto* values : {&hits.mesh, &hits.face}) values->resize(count);
  if (width == 0) width = state_->width;
  parallel_for(rays.rows, [&](std::size_t row) {
    if (width == 16) return trace_row<16>(state_->scene, rays, row, t_min, t_max, hits);
    if (width == 8) return trace_row<8>(state_->scene, rays, row, t_min, t_max, hits);
    if (width == 4) return trace_row<4>(state_->scene, rays, row, t_min, t_max, hits);
    for (std::size_t column = 0; column < rays.columns; ++column) {
      const std::size_t at = rays.index(row, column);
      const Hit hit = intersect({rays.origin_at(at), rays.direction_at(at), t_min, t_max});
      hits.t[at] = hit.t, hits.b1[at] = hit.b1, hits.b2[at] = hit.b2;
      hits.mesh[at] = hit.mesh, hits.face[at] = hit.face;
    }
  });
}

bool RayCaster::occluded(const Ray& ray) const {
  if (!ray.origin.allFinite() || !ray.direction.allFinite()) return false;
  RTCRay query = embree_ray(ray);
  EmbreeQuery().occluded(state_->scene, query);
  return query.tfar < 0;  // Embree marks an occluded ray with −∞
}

struct MeshDistance::State {
  explicit State(const Mesh& source) : mesh(source), winding(source) {}
  State(const State&) = delete;
  State& operator=(const State&) = delete;
  ~State() {
    if (scene) rtcReleaseScene(scene);
  }

  Mesh mesh;
  WindingNumber winding;
  double turn = 1;  // −1 for a mesh that is wound inside out
  RTCScene scene = nullptr;
};

MeshDistance::MeshDistance(const Mesh& mesh) {
  if (mesh.faces.empty()) throw InputError("mesh", "faces", "there are none", "give a mesh with faces");
  check_mesh({mesh, {}}, "mesh");
  state_ = std::make_unique<State>(mesh);
  State& s = *state_;
  s.turn = signed_volume(mesh) < 0 ? -1 : 1;
  const RTCDevice device = distance_device();
  s.scene = rtcNewScene(device);
  if (!attach(device, s.scene, 0, mesh, Vec3d::Zero()).complete())
    throw Failure("mesh distance", "no memory for the mesh", "give a smaller mesh or free memory");
  rtcCommitScene(s.scene);
  const RTCError code = rtcGetDeviceError(device);
  if (code != RTC_ERROR_NONE)
    throw Failure("mesh distance", "Embree error " + std::to_string(static_cast<int>(code)),
                  "check the memory that is left and the mesh size");
}

MeshDistance::~MeshDistance() = default;

double MeshDistance::distance(const Vec3d& p) const {
  RTCPointQuery query;
  query.x = static_cast<float>(p.x());
  query.y = static_cast<float>(p.y());
  query.z = static_cast<float>(p.z());
  query.radius = std::numeric_limits<float>::infinity();
  query.time = 0;
  RTCPointQueryContext context;
  rtcInitPointQueryContext(&context);
  Query best{&state_->mesh, p, std::numeric_limits<double>::infinity()};
  rtcPointQuery(state_->scene, &query, &context, visit, &best);
  return best.nearest;
}

bool MeshDistance::inside(const Vec3d& p) const {
  return state_->turn * state_->winding.at(p) > 0.5;
}

double MeshDistance::signed_distance(const Vec3d& p) const {
  return inside(p) ? -distance(p) : distance(p);
}

DistanceGrid distance_grid(const Mesh& mesh, const GridLayout& layout) {
  const MeshDistance distance(mesh);
  DistanceGrid grid{layout, std::vector<float>(layout.size())};
  const auto [nx, ny, nz] = layout.count;
  parallel_for(as_size(ny) * as_size(nz), [&, nx = nx, ny = ny](std::size_t row) {
    const int j = static_cast<int>(row % as_size(ny)), k = static_cast<int>(row / as_size(ny));
    for (int i = 0; i < nx; ++i)
      grid.values[layout.index(i, j, k)] = static_cast<float>(distance.signed_distance(layout.node(i, j, k)));
  });
  return grid;
}

}  // namespace mirage
