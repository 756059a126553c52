// Polygons of other programs' files, before they become a triangle mesh.
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "base/files.h"
#include "geometry/mesh.h"

namespace mirage {

/// Corners of a polygon at most.
inline constexpr unsigned kMaxFaceCorners = 1000;
/// Bytes of an OBJ or PLY at most.
inline constexpr std::size_t kMaxMesh = std::size_t{1} << 26;

/// Vertices and polygons of a file, in its own axes. Corners of all faces lie in one list: a list for each
/// face would take seven times the file. Each addition is checked at once.
class Polygons {
 public:
  /// `where`: the file, for errors. `collected` false: polygons are only checked and counted, not stored.
  explicit Polygons(std::string where, bool collected = true)
      : where_(std::move(where)), collected_(collected) {}
  /// Reserves room for the counts of `counted`.
  void reserve(const Polygons& counted);

  /// Adds a vertex. InputError unless it lies within gltf_limits::kMaxCoordinate.
  void add_vertex(const Vec3d& place);
  /// A corner of the next face. InputError unless `number` is a possible vertex number.
  int corner(double number) const;
  /// InputError unless the next face has 1 to kMaxFaceCorners corners.
  void check_corners(double count) const;
  /// Adds a face; its vertices may come later. InputError as check_corners and corner, and if cutting the
  /// polygons into triangles would take too long.
  void add_face(std::span<const int> corners);
  /// Notes by name a feature of the file that the mesh leaves out: colours, materials.
  void leave_out(std::string what) { left_out_.insert(std::move(what)); }
  /// The names that leave_out() got, each once.
  const std::set<std::string>& left_out() const { return left_out_; }
  /// Call it after the last face. InputError for a corner without a vertex.
  void finish() const;
  /// Throws an InputError that names this file.
  [[noreturn]] void fail(const std::string& field, const std::string& problem,
                         const std::string& fix = "export the mesh again") const;

  /// Vertices so far, kept or not.
  std::size_t vertex_count() const { return vertex_count_; }
  /// Faces so far, kept or not.
  std::size_t face_count() const { return face_count_; }
  /// The vertices in the file's axes and units; empty if not collected.
  const std::vector<Vec3d>& vertices() const { return vertices_; }
  /// The vertices of a face, by number.
  std::span<const int> face(std::size_t f) const {
    const std::size_t begin = f == 0 ? 0 : ends_[f - 1];
    return std::span(corners_).subspan(begin, ends_[f] - begin);
  }

 private:
  std::string where_;
  bool collected_;
  std::size_t vertex_count_ = 0, face_count_ = 0, corner_count_ = 0, cutting_ = 0;
  int largest_ = -1;            // corner
  std::size_t largest_of_ = 0;  // the first face that has it
  std::vector<Vec3d> vertices_;
  std::vector<int> corners_;
  std::vector<std::size_t> ends_;
  std::set<std::string> left_out_;
};

/// Runs `read` twice and returns what the second run adds. The first run only checks, so that a file with an
/// error at its end takes no memory. InputError as `read`, Polygons, and FileCharacters with kMaxMesh;
/// `where` is the path as the user gave it.
Polygons read_polygons(const std::filesystem::path& file, const std::string& where,
                       const std::function<void(FileCharacters&, Polygons&)>& read);

/// All polygons cut into triangles (triangulate_polygon); points and lines (one corner, two) left out.
/// Interrupted after Ctrl-C.
Mesh triangulated(const Polygons& polygons);

/// The mesh with coincident vertices merged, without faces of fewer than three different vertices, and
/// without unused vertices.
Mesh welded(const Mesh& mesh);

// PLY files (Turk, "The PLY Polygon File Format", 1994): text and binary of both byte orders, any scalar
// types. We have our own reader, because assimp's (5.2) ends the program, reads past the file's end, or
// allocates the size that a damaged file claims.

/// The elements "vertex" (properties x, y, z) and "face" (list vertex_indices or vertex_index); others are
/// skipped. InputError naming the field for an invalid header, one that claims more than the file holds, and
/// a body that ends too early; otherwise as Polygons. For read_polygons.
void read_ply(FileCharacters& from, Polygons& into);

}  // namespace mirage
