#include "exchange/polygons.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <tuple>

#include "base/error.h"
#include "base/interrupt.h"
#include "exchange/gltf_document.h"
#include "geometry/polygon.h"

namespace mirage {

void Polygons::fail(const std::string& field, const std::string& problem, const std::string& fix) const {
  throw InputError(where_, field, problem, fix);
}

void Polygons::reserve(const Polygons& counted) {
  vertices_.reserve(counted.vertex_count_);
  corners_.reserve(counted.corner_count_);
  ends_.reserve(counted.face_count_);
}

void Polygons::add_vertex(const Vec3d& place) {
  if (!(place.cwiseAbs().maxCoeff() <= gltf_limits::kFurthest))
    fail(fmt::format("vertex {}", vertex_count_), fmt::format("is not within {:g} m", gltf_limits::kFurthest),
         "export the mesh in metres");
  ++vertex_count_;
  if (kept_) vertices_.push_back(place);
}

int Polygons::corner(double number) const {
  if (!(number >= 0 && number < std::numeric_limits<int>::max() && number == std::floor(number)))
    fail(fmt::format("face {}", face_count_),
         fmt::format("names vertex {:g}, which is none's number", number));
  return static_cast<int>(number);
}

void Polygons::check_corners(double count) const {
  if (!(count >= 1 && count <= kMostFaceCorners && count == std::floor(count)))
    fail(fmt::format("face {}", face_count_),
         fmt::format("has {:g} corners, not 1 to {}", count, kMostFaceCorners),
         "cut its polygons into triangles");
}

void Polygons::add_face(std::span<const int> corners) {
  check_corners(static_cast<double>(corners.size()));
  for (const int vertex : corners)
    if (corner(vertex) > largest_) largest_ = vertex, largest_of_ = face_count_;
  if (corners.size() > 4 && (cutting_ += corners.size() * corners.size()) > kMostCutting)
    fail("faces", "are too many of too many corners", "cut its polygons into triangles");
  ++face_count_;
  corner_count_ += corners.size();
  if (!kept_) return;
  corners_.insert(corners_.end(), corners.begin(), corners.end());
  ends_.push_back(corners_.size());
}

void Polygons::finish() const {
  if (largest_ >= 0 && static_cast<std::size_t>(largest_) >= vertex_count_)
    fail(fmt::format("face {}", largest_of_), fmt::format("names vertex {} of {}", largest_, vertex_count_));
}

Polygons read_polygons(const std::filesystem::path& file, const std::string& where,
                       const std::function<void(FileCharacters&, Polygons&)>& read) {
  const auto once = [&](Polygons polygons) {
    FileCharacters from(file, kLargestMesh);
    read(from, polygons);
    polygons.finish();
    return polygons;
  };
  Polygons kept(where);
  kept.reserve(once(Polygons(where, false)));
  return once(std::move(kept));
}

Mesh triangulated(const Polygons& polygons) {
  Mesh mesh{polygons.vertices(), {}};
  std::vector<Vec3d> corners;
  for (std::size_t f = 0; f < polygons.face_count(); ++f) {
    const std::span<const int> polygon = polygons.face(f);
    if (polygon.size() == 3) {
      mesh.faces.push_back({polygon[0], polygon[1], polygon[2]});
      continue;
    }
    throw_if_interrupted("nothing was written");
    corners.clear();
    for (const int corner : polygon) corners.push_back(mesh.vertices[static_cast<std::size_t>(corner)]);
    for (const auto& [a, b, c] : cut_polygon(corners))
      mesh.faces.push_back({polygon[static_cast<std::size_t>(a)], polygon[static_cast<std::size_t>(b)],
                            polygon[static_cast<std::size_t>(c)]});
  }
  return mesh;
}

Mesh joined(const Mesh& mesh) {
  const auto place = [&](std::size_t v) {
    const Vec3d& p = mesh.vertices[v];
    return std::tuple(p.x(), p.y(), p.z());
  };
  std::vector<std::size_t> order(mesh.vertices.size()), first(mesh.vertices.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return place(a) < place(b); });
  for (std::size_t i = 0; i < order.size(); ++i)
    first[order[i]] = i > 0 && place(order[i - 1]) == place(order[i]) ? first[order[i - 1]] : order[i];
  Mesh result;
  std::vector<int> number(mesh.vertices.size(), -1);
  for (const Face& face : mesh.faces) {
    std::array<std::size_t, 3> corners;
    for (std::size_t k = 0; k < 3; ++k) corners[k] = first[static_cast<std::size_t>(face[k])];
    if (corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[0]) continue;
    Face& kept = result.faces.emplace_back();
    for (std::size_t k = 0; k < 3; ++k) {
      int& own = number[corners[k]];
      if (own < 0) {
        own = static_cast<int>(result.vertices.size());
        result.vertices.push_back(mesh.vertices[corners[k]]);
      }
      kept[k] = own;
    }
  }
  return result;
}

}  // namespace mirage
