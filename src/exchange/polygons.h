// What files of other programs hold before it is a triangle mesh.
#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "geometry/mesh.h"

namespace mirage {

/// Corners of a polygon at most, and of all polygons of more than four the sum of their squares: cutting one
/// takes time by their square.
inline constexpr unsigned kMostCorners = 1000;
inline constexpr std::size_t kMostCutting = std::size_t{1} << 27;
/// Bytes of an OBJ or PLY at most.
inline constexpr std::size_t kLargestMesh = std::size_t{1} << 26;

/// Vertices and polygons of a file, in its own axes. Corners of all faces lie in one list: a list for each
/// would take seven times the file.
class Polygons {
 public:
  std::vector<Vec3d> vertices;

  std::size_t face_count() const { return ends_.size(); }
  /// The vertices of a face, by number.
  std::span<const int> face(std::size_t f) const {
    const std::size_t begin = f == 0 ? 0 : ends_[f - 1];
    return std::span(corners_).subspan(begin, ends_[f] - begin);
  }
  void add_face(std::span<const int> corners) {
    corners_.insert(corners_.end(), corners.begin(), corners.end());
    ends_.push_back(corners_.size());
  }

 private:
  std::vector<int> corners_;
  std::vector<std::size_t> ends_;
};

/// InputError naming `where` and the face unless it has 1 to kMostCorners corners.
void check_corners(double count, std::size_t face, const std::string& where);
/// InputError naming `where` and the face unless `vertex` is the number of one of `count` vertices.
void check_corner(double vertex, std::size_t count, std::size_t face, const std::string& where);

/// All polygons cut into triangles (cut_polygon); points and lines (one corner, two) left out. InputError
/// naming `where` for more work than kMostCutting. Interrupted after Ctrl-C.
Mesh triangulated(const Polygons& polygons, const std::string& where);

/// The mesh with its vertices at one place made one, and without faces that have no three of them or vertices
/// that no face has.
Mesh joined(const Mesh& mesh);

}  // namespace mirage
