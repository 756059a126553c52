#include "arrays.h"
#include "base/error.h"
#include "base/sizes.h"
#include "bind.h"
#include "sensors/lidar_model.h"
#include "sensors/ray_caster.h"

namespace mirage::python {
namespace {

/// Hits of rays: the face by Embree in float, the place on it in double.
struct Hits {
  std::vector<std::shared_ptr<TexturedMesh>> meshes;
  std::vector<Vec3d> origins, directions, points, barycentrics;
  std::vector<double> ranges;
  std::vector<int> mesh, face;
};
using SharedHits = std::shared_ptr<Hits>;

std::array<Vec3d, 3> corners_of(const Hits& hits, std::size_t ray) {
  const Mesh& mesh = hits.meshes[as_size(hits.mesh[ray])]->mesh;
  return mesh.corners(mesh.faces[as_size(hits.face[ray])]);
}

FaceReturn<double> place_of(const Hits& hits, std::size_t ray, const Vec3d& unit) {
  return intersect_face<double>(hits.origins[ray], unit, corners_of(hits, ray), 1.0);
}

SharedHits cast(const std::vector<std::shared_ptr<TexturedMesh>>& meshes, const py::object& origins,
                const py::object& directions, double t_min, double t_max) {
  auto hits = std::make_shared<Hits>();
  hits->origins = rows_of_three(origins, "origins");
  hits->directions = rows_of_three(directions, "directions");
  const std::size_t count = hits->directions.size();
  if (hits->origins.size() == 1) hits->origins.resize(count, Vec3d(hits->origins.front()));
  if (hits->origins.size() != count)
    throw InputError("origins", "shape",
                     std::to_string(hits->origins.size()) + " for " + std::to_string(count) + " directions",
                     "give one origin, or one a ray");
  if (meshes.empty()) throw InputError("meshes", "", "there are none", "give a mesh or a list of them");
  for (const auto& mesh : meshes)  // as they are now: the arrays may be written to later
    hits->meshes.push_back(std::make_shared<TexturedMesh>(*mesh));
  const py::gil_scoped_release free;
  std::vector<Mesh> shapes;
  for (const auto& mesh : hits->meshes) {
    check_mesh(*mesh, "mesh");
    shapes.push_back(mesh->mesh);
  }
  const Vec3d centre = count > 0 ? hits->origins.front() : Vec3d::Zero();
  const RayCaster caster(shapes, centre);
  std::vector<Ray> rays(count);
  for (std::size_t i = 0; i < count; ++i)
    rays[i] = {(hits->origins[i] - centre).cast<float>(), hits->directions[i].cast<float>(),
               static_cast<float>(t_min), static_cast<float>(std::min(t_max, 1e30))};
  std::vector<Hit> met(count);
  caster.intersect(rays, met);
  hits->mesh.assign(count, -1);
  hits->face.assign(count, -1);
  const double nothing = std::numeric_limits<double>::quiet_NaN();
  hits->ranges.assign(count, std::numeric_limits<double>::infinity());
  hits->points.assign(count, Vec3d::Constant(nothing));
  hits->barycentrics.assign(count, Vec3d::Constant(nothing));
  for (std::size_t i = 0; i < count; ++i) {
    if (!met[i].hit()) continue;
    hits->mesh[i] = met[i].mesh;
    hits->face[i] = met[i].face;
    const double length = hits->directions[i].norm();
    const FaceReturn<double> place = place_of(*hits, i, hits->directions[i] / length);
    hits->ranges[i] = place.valid ? place.range / length : met[i].t;
    hits->barycentrics[i] =
        place.valid ? place.barycentric : Vec3d(1.0 - met[i].b1 - met[i].b2, met[i].b1, met[i].b2);
    hits->points[i] = hits->origins[i] + hits->ranges[i] * hits->directions[i];
  }
  return hits;
}

std::vector<py::array_t<double>> hits_vjp(const Hits& hits, const py::object& d_points) {
  const std::vector<Vec3d> upstream = rows_of_three(d_points, "d_points");
  if (upstream.size() != hits.points.size())
    throw InputError(
        "d_points", "shape",
        std::to_string(upstream.size()) + " rows for " + std::to_string(hits.points.size()) + " rays",
        "give one row a ray");
  std::vector<std::vector<Vec3d>> gradients;
  for (const auto& mesh : hits.meshes) gradients.emplace_back(mesh->mesh.vertices.size(), Vec3d::Zero());
  for (std::size_t i = 0; i < upstream.size(); ++i) {
    if (hits.mesh[i] < 0) continue;
    if (!upstream[i].allFinite())
      throw Failure("d_points", "row " + std::to_string(i) + " is not finite",
                    "check the loss it comes from");
    constexpr double kGrazing = 0.05;  // as SimulationSettings::grazing_cosine
    const Vec3d unit = hits.directions[i].normalized();
    const auto d_face = intersect_face_vjp<double>(unit, corners_of(hits, i), place_of(hits, i, unit), 1.0,
                                                   kGrazing, upstream[i], 0.0);
    const auto mesh = as_size(hits.mesh[i]);
    const Face& face = hits.meshes[mesh]->mesh.faces[as_size(hits.face[i])];
    for (std::size_t k = 0; k < 3; ++k) gradients[mesh][as_size(face[k])] += d_face[k];
  }
  std::vector<py::array_t<double>> arrays;
  arrays.reserve(gradients.size());
  for (auto& gradient : gradients) arrays.push_back(own_rows(std::move(gradient)));
  return arrays;
}

template <class T>
py::array_t<T> list(const SharedHits& hits, const std::vector<T>& values) {
  return view(values.data(), {ssize(values.size())}, hits, false);
}

}  // namespace

void bind_rays(py::module_& module) {
  py::class_<Hits, SharedHits>(module, "Hits", "What N rays hit, one entry per ray.")
      .def_property_readonly(
          "t", [](const SharedHits& h) { return list(h, h->ranges); },
          "N float64: point = origin + t · direction; inf where a ray hits nothing")
      .def_property_readonly(
          "mesh", [](const SharedHits& h) { return list(h, h->mesh); },
          "N int32: the mesh that a ray hits; -1: none")
      .def_property_readonly(
          "face", [](const SharedHits& h) { return list(h, h->face); },
          "N int32: the face of that mesh; -1: none")
      .def_property_readonly(
          "barycentrics", [](const SharedHits& h) { return view_rows(h->barycentrics, h, false); },
          "N×3 float64: weights of the face's corners; nan where a ray hits nothing")
      .def_property_readonly(
          "points", [](const SharedHits& h) { return view_rows(h->points, h, false); },
          "N×3 float64: the points that are hit, m; nan where a ray hits nothing")
      .def("vjp", &hits_vjp, py::arg("d_points"),
           "Vector-Jacobian product: from d loss / d points (N×3) to a list of d loss / d vertices (V×3 "
           "float64),\n"
           "one per mesh. Which face a ray hits has no gradient. Below an incidence cosine of 0.05 the "
           "gradient\n"
           "is scaled down.");
  module.def("cast_rays", &cast);
}

}  // namespace mirage::python
