// What files of other programs hold before it is a triangle mesh.
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
/// would take seven times the file. What a reader adds is checked then.
class Polygons {
 public:
  /// `where`: the file, for errors. Not `collected`: only checked and counted, in no memory.
  explicit Polygons(std::string where, bool collected = true)
      : where_(std::move(where)), collected_(collected) {}
  /// Room for what `counted` has counted.
  void reserve(const Polygons& counted);

  /// InputError unless it lies within gltf_limits::kMaxCoordinate.
  void add_vertex(const Vec3d& place);
  /// A corner of the next face. InputError unless it is the number that a vertex may have.
  int corner(double number) const;
  /// InputError unless the next face has 1 to kMaxFaceCorners corners.
  void check_corners(double count) const;
  /// The vertices may follow. InputError as check_corners and corner, and where cutting the polygons into
  /// triangles would take too long.
  void add_face(std::span<const int> corners);
  /// Notes what the file holds and a mesh does not, by its name: colours, materials.
  void leave_out(std::string what) { left_out_.insert(std::move(what)); }
  /// What leave_out() was told, each once.
  const std::set<std::string>& left_out() const { return left_out_; }
  /// After the last one. InputError for a corner without a vertex.
  void finish() const;
  /// InputError with this file.
  [[noreturn]] void fail(const std::string& field, const std::string& problem,
                         const std::string& fix = "export the mesh again") const;

  /// Vertices so far, kept or not.
  std::size_t vertex_count() const { return vertex_count_; }
  /// Faces so far, kept or not.
  std::size_t face_count() const { return face_count_; }
  /// The vertices in the file's axes and units; none where they are not kept.
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

/// What `read` adds, twice: first only to be checked, so that a file that is wrong at its end takes no
/// memory. InputError as `read`, Polygons, and FileCharacters with kMaxMesh; `where` is the file as it
/// was given.
Polygons read_polygons(const std::filesystem::path& file, const std::string& where,
                       const std::function<void(FileCharacters&, Polygons&)>& read);

/// All polygons cut into triangles (triangulate_polygon); points and lines (one corner, two) left out.
/// Interrupted after Ctrl-C.
Mesh triangulated(const Polygons& polygons);

/// The mesh with its vertices at one place made one, and without faces that have no three of them or vertices
/// that no face has.
Mesh welded(const Mesh& mesh);

// PLY files (Turk, "The PLY Polygon File Format", 1994): text and binary of both byte orders, any scalar
// types. By our own reader, because assimp's (5.2) ends the program, reads past the file's end or takes
// memory by what a damaged one claims.

/// The elements "vertex" (properties x, y, z) and "face" (list vertex_indices or vertex_index); others are
/// read over. InputError naming the field for a header that is none or claims more than the file holds, and a
/// body that ends too early; else as Polygons. For read_polygons.
void read_ply(FileCharacters& from, Polygons& into);

}  // namespace mirage
