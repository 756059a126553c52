#include "sensors/mesh_distance.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "base/error.h"
#include "base/parallel.h"
#include "geometry/solid.h"
#include "sensors/embree.h"

namespace mirage {
namespace {

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
  const double d = (nearest_on(v[f[0]], v[f[1]], v[f[2]], query.p) - query.p).norm();
  if (d >= query.nearest) return false;
  query.nearest = d;
  // A little more than d: the box tests are in single precision.
  arguments->query->radius = static_cast<float>(d * (1 + 1e-6) + 1e-7);
  return true;
}

// One device for all meshes: each keeps some 30 MB of its own, and a shape model is learnt from hundreds.
RTCDevice distance_device() {
  static const struct Device {
    RTCDevice device = rtcNewDevice("threads=1");
    ~Device() { rtcReleaseDevice(device); }
  } owner;
  return owner.device;
}

}  // namespace

struct MeshDistance::State {
  explicit State(const Mesh& given) : mesh(given), winding(given) {}
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
  const RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(
      geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), mesh.vertices.size()));
  auto* faces = static_cast<unsigned*>(rtcSetNewGeometryBuffer(
      geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 3 * sizeof(unsigned), mesh.faces.size()));
  if (!vertices || !faces)
    throw Failure("mesh distance", "no memory for the mesh", "give a smaller mesh or free memory");
  for (const Vec3d& v : mesh.vertices)
    for (int k = 0; k < 3; ++k) *vertices++ = static_cast<float>(v[k]);
  for (const Face& f : mesh.faces)
    for (int v : f) *faces++ = static_cast<unsigned>(v);
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(s.scene, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(s.scene);
  const RTCError code = rtcGetDeviceError(device);
  if (code != RTC_ERROR_NONE)
    throw Failure("mesh distance", "Embree error " + std::to_string(static_cast<int>(code)),
                  "check the memory that is left and the mesh size");
}

MeshDistance::~MeshDistance() = default;
MeshDistance::MeshDistance(MeshDistance&&) noexcept = default;
MeshDistance& MeshDistance::operator=(MeshDistance&&) noexcept = default;

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
  parallel_for(static_cast<std::size_t>(ny) * nz, [&, nx = nx, ny = ny](std::size_t row) {
    const int j = static_cast<int>(row % ny), k = static_cast<int>(row / ny);
    for (int i = 0; i < nx; ++i)
      grid.values[layout.index(i, j, k)] = static_cast<float>(distance.signed_distance(layout.node(i, j, k)));
  });
  return grid;
}

}  // namespace mirage
