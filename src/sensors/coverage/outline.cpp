#include "sensors/coverage/outline.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "base/sizes.h"
#include "geometry/mesh.h"

namespace mirage::coverage {
namespace {

/// Perspective-correct barycentrics of a point, within the face.
Vec3d on_face(const ScreenFace& face, const Vec2d& p) {
  Vec3d b = face.barycentrics(p);
  for (int k = 0; k < 3; ++k) b[k] = std::max(b[k], 0.0) * face.inv_z[k];
  return b / b.sum();
}

/// The point at perspective-correct barycentrics.
Vec2d on_screen(const ScreenFace& face, const Vec3d& b) {
  Vec2d sum = Vec2d::Zero();
  double weight = 0;
  for (int k = 0; k < 3; ++k) {
    sum += b[k] * face.z[k] * face.s[k];
    weight += b[k] * face.z[k];
  }
  return sum / weight;
}

/// The texture's barycentrics of the face's corners: of the source face, if this one is a part of it.
struct TextureCorners {
  Vec3d at[3];
  std::size_t owner = 0;

  TextureCorners(const ScreenMesh<double>& mesh, const ScreenFace& face) {
    const auto f = as_size(face.face);
    const bool part = !mesh.corner_barycentrics.empty();
    for (int k = 0; k < 3; ++k)
      at[k] =
          part ? mesh.corner_barycentrics[f][as_size(face.corner[k])] : Vec3d(Vec3d::Unit(face.corner[k]));
    owner = part ? as_size(mesh.texel_face[f]) : f;
  }
  /// The three quantities whose multiples of 1/C are texel borders: b0, b1, b0 + b1 (TexelAtlas).
  double border(int family, int k) const {
    return family == 0 ? at[k][0] : family == 1 ? at[k][1] : at[k][0] + at[k][1];
  }
};

/// The line on screen where a quantity that is linear on the face, `c` at its corners, is zero; positive side
/// as the quantity. False if it does not cross the face.
bool zero_line(const ScreenFace& face, const double* c, Line& line) {
  Vec2d ends[3];
  int count = 0, largest = 0;
  for (int k = 0; k < 3; ++k) {
    const int next = (k + 1) % 3;
    if (std::abs(c[k]) > std::abs(c[largest])) largest = k;
    if (c[k] == 0) {
      ends[count++] = face.s[k];
    } else if (c[k] * c[next] < 0) {
      // b_k z_k / (b_k z_k + b_next z_next) with b_k ∝ |c_next|
      const double a = std::abs(c[next]) * face.z[k], b = std::abs(c[k]) * face.z[next];
      ends[count++] = face.s[k] + b / (a + b) * (face.s[next] - face.s[k]);
    }
  }
  if (count != 2) return false;
  const Vec2d e = ends[1] - ends[0];
  const double length = e.norm();
  if (!(length > face.slack)) return false;
  line.normal = Vec2d(-e.y(), e.x()) / length;
  line.through = ends[0];
  line.slack = face.slack;
  if ((line.at(face.s[largest]) > 0) != (c[largest] > 0)) line.normal = -line.normal;
  return true;
}

/// Divides outline.cells, parts of one face, at the borders of its texels.
void divide(const ScreenFace& face, int index, const TextureCorners& texture, int resolution,
            Outline& outline) {
  Polygon front, back;
  for (int family = 0; family < 3; ++family) {
    outline.borders.clear();
    for (int m = 1; m < resolution; ++m) {
      double c[3];
      for (int k = 0; k < 3; ++k) c[k] = texture.border(family, k) - double(m) / resolution;
      Line line;
      if (zero_line(face, c, line)) outline.borders.push_back(line);
    }
    outline.current.swap(outline.cells);
    outline.cells.clear();
    for (Polygon rest : outline.current) {
      for (const Line& line : outline.borders) {
        split(outline.pool, rest, line, {On::texel, 0, index, -1}, front, back);
        if (!back.empty()) outline.cells.push_back(back);
        rest = front;
        if (rest.empty()) break;
      }
      if (!rest.empty()) outline.cells.push_back(rest);
    }
  }
}

Point carried(const Visible& visible, const Vec2d& p, const Side& side, double inv_limit) {
  Point point{p, side.on, side.edge, side.face, side.other, 0, 0};
  if (side.on == On::fixed) return point;
  const ScreenFace& face = visible.faces[as_size(side.face)];
  if (side.on == On::edge) {
    const Vec2d& from = face.s[side.edge];
    const Vec2d e = face.s[(side.edge + 1) % 3] - from;
    point.a = (p - from).dot(e) / e.squaredNorm();
  } else if (side.on == On::texel) {
    const Vec3d b = on_face(face, p);
    point.a = b[0], point.b = b[1];
  } else if (side.on == On::limit) {
    point.a = inv_limit;
  }
  return point;
}

/// All texels of a fully visible face: each border once, with the texels of both sides.
void outline_whole(const ScreenMesh<double>& mesh, const ScreenFace& face, int index, Outline& outline) {
  const auto owner = as_size(face.face);
  const int c = mesh.resolution_of(owner), base = static_cast<int>(mesh.first_texel(owner)),
            first = static_cast<int>(outline.points.size());
  const bool flipped = face.corner[1] == 2;
  // Row j of the grid has c + 1 − j points.
  const auto at = [&](int i, int j) { return first + j * (c + 1) - j * (j - 1) / 2 + i; };
  for (int j = 0; j <= c; ++j)
    for (int i = 0; i + j <= c; ++i) {
      const Vec3d in_mesh(double(i) / c, double(j) / c, double(c - i - j) / c);
      const Vec3d b(in_mesh[face.corner[0]], in_mesh[face.corner[1]], in_mesh[face.corner[2]]);
      outline.points.push_back({on_screen(face, b), On::texel, 0, index, -1, b[0], b[1]});
    }
  const auto add = [&](int from, int to, int inside, int outside) {
    if (flipped) std::swap(from, to);
    outline.edges.push_back({from, to, inside, outside});
  };
  const auto upper = [&](int i, int j) {
    return i < 0 || j < 0 || i + j > c - 2 ? -1 : base + (c - 1 - j) * c + (c - 1 - i);
  };
  for (int j = 0; j < c; ++j)
    for (int i = 0; i + j < c; ++i) {
      const int lower = base + j * c + i;
      add(at(i, j), at(i + 1, j), lower, upper(i, j - 1));
      add(at(i + 1, j), at(i, j + 1), lower, upper(i, j));
      add(at(i, j + 1), at(i, j), lower, upper(i - 1, j));
    }
}

/// d loss / d face, given d loss / d position of a point that is fixed in the texture.
void add_texel_force(const ScreenMesh<double>& mesh, const ScreenFace& face, const Point& point,
                     const Vec2d& edge_gradient, FaceGradient& out) {
  const Vec3d b(point.a, point.b, 1 - point.a - point.b);
  double weight = 0;
  for (int k = 0; k < 3; ++k) weight += b[k] * face.z[k];
  Vec3d d_b;
  for (int k = 0; k < 3; ++k) {
    const double along = edge_gradient.dot(face.s[k] - point.p) / weight;
    out.s[k] += b[k] * face.z[k] / weight * edge_gradient;
    out.z[k] += b[k] * along;
    d_b[k] = face.z[k] * along;
  }
  if (mesh.corner_barycentrics.empty()) return;
  // Its texture coordinates are Σ b_k t_k, t those of the corners: as t moves, b must compensate.
  const TextureCorners texture(mesh, face);
  Eigen::Matrix3d corners;
  for (int k = 0; k < 3; ++k) corners.row(k) = texture.at[k].transpose();
  Eigen::Matrix3d inverse;
  bool invertible = false;
  corners.computeInverseWithCheck(inverse, invertible, 1e-15);
  if (!invertible) return;
  const Vec3d u = inverse * d_b;
  for (int k = 0; k < 3; ++k) out.barycentrics[k] -= b[k] * u;
}

/// 1/z of a face at a point: `scale` times its derivative.
void add_inv_depth(const ScreenFace& face, const Vec2d& p, double scale, FaceGradient& out) {
  const Vec3d b = face.barycentrics(p);
  for (int k = 0; k < 3; ++k) {
    out.s[k] -= scale * b[k] * face.slope;
    out.z[k] -= scale * b[k] * face.inv_z[k] * face.inv_z[k];
  }
}

}  // namespace

void outline_piece(const ScreenMesh<double>& mesh, const Visible& visible, const Piece& piece,
                   Outline& outline, double limit) {
  const ScreenFace& face = visible.faces[as_size(piece.face)];
  const double inv_limit = 1 / limit;
  if (face.nearest <= inv_limit) return;
  const bool clipped = face.farthest < inv_limit;
  if (piece.whole && !clipped && mesh.corner_barycentrics.empty())
    return outline_whole(mesh, face, piece.face, outline);
  Pool& pool = outline.pool;
  pool.corners.clear();
  Polygon polygon = pool.copy(visible.pool, piece.polygon);
  if (clipped) {
    double c[3];
    for (int k = 0; k < 3; ++k) c[k] = limit - face.z[k];  // linear on the face itself
    Line line;
    Polygon back;
    if (zero_line(face, c, line))
      split(pool, Polygon(polygon), line, {On::limit, 0, piece.face, -1}, polygon, back);
  }
  outline.cells.clear();
  if (!polygon.empty()) outline.cells.push_back(polygon);
  const TextureCorners texture(mesh, face);
  const int resolution = mesh.resolution_of(texture.owner),
            first_texel = static_cast<int>(mesh.first_texel(texture.owner));
  divide(face, piece.face, texture, resolution, outline);
  for (const Polygon& cell : outline.cells) {
    Vec2d middle = Vec2d::Zero();
    for (int i = 0; i < cell.count; ++i) middle += pool.corner(cell, i).p / cell.count;
    const Vec3d b = on_face(face, middle);
    const Vec3d t = b[0] * texture.at[0] + b[1] * texture.at[1] + b[2] * texture.at[2];
    const int texel = first_texel + texel_index(t[0], t[1], resolution);
    for (int i = 0; i < cell.count; ++i) {
      const Corner& from = pool.corner(cell, i);
      const Corner& to = pool.corner(cell, i + 1 < cell.count ? i + 1 : 0);
      const int point = static_cast<int>(outline.points.size());
      outline.points.push_back(carried(visible, from.p, from.side, inv_limit));
      outline.points.push_back(carried(visible, to.p, from.side, inv_limit));
      outline.edges.push_back({point, point + 1, texel, -1});
    }
  }
}

void add_edge_gradients(const ScreenMesh<double>& mesh, const Visible& visible, const Outline& outline,
                        const std::vector<Vec2d>& edge_gradients, double image_size,
                        std::vector<FaceGradient>& faces) {
  const auto crossing = [&](const Vec2d& slope, double scale, const Vec2d& f) {
    // The line D = 0 with gradient `slope` moves by −∂D / |slope| along it.
    const double steep = slope.norm(), least = kMinCrossing * scale;
    return steep > 0 ? -f.dot(slope) / steep / steep * std::min(1.0, steep / least) : 0.0;
  };
  for (std::size_t i = 0; i < outline.points.size(); ++i) {
    const Point& point = outline.points[i];
    const Vec2d& f = edge_gradients[i];
    if (point.on == On::fixed || (f.x() == 0 && f.y() == 0)) continue;
    const ScreenFace& face = visible.faces[as_size(point.face)];
    FaceGradient& own = faces[as_size(point.face)];
    switch (point.on) {
      case On::edge:
        own.s[point.edge] += (1 - point.a) * f;
        own.s[(point.edge + 1) % 3] += point.a * f;
        break;
      case On::texel:
        add_texel_force(mesh, face, point, f, own);
        break;
      case On::crossing: {
        const ScreenFace& other = visible.faces[as_size(point.other)];
        const double scale =
            face.slope.norm() + other.slope.norm() + std::max(face.nearest, other.nearest) / image_size;
        const double speed = crossing(face.slope - other.slope, scale, f);
        add_inv_depth(face, point.p, speed, own);
        add_inv_depth(other, point.p, -speed, faces[as_size(point.other)]);
        break;
      }
      case On::limit:
        add_inv_depth(face, point.p, crossing(face.slope, face.slope.norm() + face.nearest / image_size, f),
                      own);
        break;
      case On::fixed:
        break;
    }
  }
}

}  // namespace mirage::coverage
