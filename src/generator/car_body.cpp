#include "generator/car_body.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/sizes.h"

namespace mirage::generator {
namespace {

constexpr int kStations = 56;
constexpr int kSide = 5, kArc = 7;            // rows of the glasshouse's side and of the roof's arc
constexpr int kLower = 8;                     // points below the belt, the belt included
constexpr int kHalf = kLower + kSide + kArc;  // points of half a section

double smoothstep(double low, double high, double x) {
  const double t = std::clamp((x - low) / (high - low), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

double interpolate(const std::vector<Vec2d>& line, double u) {
  if (u <= line.front().x()) return line.front().y();
  for (std::size_t i = 1; i < line.size(); ++i)
    if (u <= line[i].x()) {
      const double t = (u - line[i - 1].x()) / std::max(1e-9, line[i].x() - line[i - 1].x());
      return std::lerp(line[i - 1].y(), line[i].y(), t);
    }
  return line.back().y();
}

// Rounds a profile's corners: mean over a short window of u.
double rounded(const std::vector<Vec2d>& line, double u, double window) {
  double sum = 0;
  for (int i = -3; i <= 3; ++i) sum += interpolate(line, std::clamp(u + window * i / 3, 0.0, 1.0));
  return sum / 7;
}

struct Section {
  std::vector<Vec2d> points;  // (y, z), from the bottom's middle up the left side to the top's middle
  double rise = 0;            // height of the glasshouse over the belt, share of h
};

class Loft {
 public:
  explicit Loft(const BodyShape& s) : s_(s) {
    top_ = {{0, s.nose},
            {0.02, std::lerp(s.nose, s.bonnet, 0.75)},
            {0.06, s.bonnet},
            {0.5 * s.cowl_u, std::lerp(s.bonnet, s.cowl, 0.62)},
            {s.cowl_u, s.cowl},
            {s.roof_front_u, 0.955},
            {std::lerp(s.roof_front_u, s.roof_peak_u, 0.4), 0.988},
            {s.roof_peak_u, 1.0},
            {std::lerp(s.roof_peak_u, s.roof_rear_u, 0.6), 0.5 + 0.5 * s.roof_rear + 0.012},
            {s.roof_rear_u, s.roof_rear},
            {s.window_foot_u, s.window_foot},
            {std::max(s.window_foot_u + 0.004, 0.985), std::lerp(s.window_foot, s.tail, 0.5)},
            {1, s.tail}};
  }

  double half_width(double u) const {
    const double front = 0.14, rear = 0.10;
    double share = 1;
    if (u < front) share -= s_.nose_round * std::pow((front - u) / front, 2.6);
    if (u > 1 - rear) share -= s_.tail_round * std::pow((u - 1 + rear) / rear, 2.6);
    // A car is widest around its middle.
    share -= 0.035 * std::pow(std::abs(u - 0.55) / 0.55, 2.0);
    return 0.5 * s_.width * share;
  }

  Section section(double u) const {
    Section out;
    const double h = s_.height, top = rounded(top_, u, 0.014);
    const double belt = std::min(std::lerp(s_.belt_front, s_.belt_rear, u), top - 0.035);
    out.rise = top - belt;
    const double ends = smoothstep(0.10, 0, u) + smoothstep(0.90, 1, u);
    const double bottom = s_.clearance + 0.06 * ends;
    const double w = half_width(u), middle = std::lerp(bottom, belt, 0.62);
    // Rounded ends: bumper and lamps lean back above and below the bumper's line.
    const std::vector<Vec2d> lower = {{0, bottom},
                                      {0.80 * w, bottom},
                                      {0.93 * w, bottom + 0.02},
                                      {0.975 * w, std::lerp(bottom, middle, 0.35)},
                                      {0.99 * w, std::lerp(bottom, middle, 0.7)},
                                      {w, middle},
                                      {0.992 * w, std::lerp(middle, belt, 0.7)},
                                      {0.962 * w, belt}};
    for (const Vec2d& p : lower) out.points.push_back({p.x(), p.y() * h});
    const double cabin = smoothstep(0.06, 0.22, out.rise), k = 0.10 + (s_.tumblehome - 0.10) * cabin;
    const double base = 0.955 * w, edge = base * (1 - k), shoulder = std::lerp(0.55, 0.86, cabin);
    for (int i = 1; i <= kSide; ++i) {
      const double t = static_cast<double>(i) / kSide;
      const double bulge = 0.012 * std::sin(kPi * t);
      out.points.push_back(
          {base * (1 - k * std::pow(t, 1.15) + bulge), h * (belt + out.rise * shoulder * t)});
    }
    for (int i = 1; i <= kArc; ++i) {
      const double a = 0.5 * kPi * i / kArc;
      const double y = std::pow(std::max(0.0, std::cos(a)), 0.75), z = std::pow(std::sin(a), 0.75);
      out.points.push_back(
          {i == kArc ? 0 : edge * y, h * (belt + out.rise * (shoulder + (1 - shoulder) * z))});
    }
    return out;
  }

  enum class Kind { paint, glass, trim };
  Kind kind(double u, int row, double rise) const {
    const bool arc = row >= kLower + kSide - 1, side = row >= kLower - 1 && !arc;
    if (row < 2) return Kind::trim;
    if (row < 3 && u > 0.1 && u < 0.92) return Kind::trim;
    const double post = 0.011;
    if (arc) {
      const int step = row - (kLower + kSide - 1);
      if (u > s_.cowl_u + 0.012 && u < s_.roof_front_u - 0.006) return step < 1 ? Kind::paint : Kind::glass;
      if (s_.rear_glass && u > s_.roof_rear_u + 0.012 && u < s_.window_foot_u - 0.010)
        return step < 2 ? Kind::paint : Kind::glass;
      return Kind::paint;
    }
    if (side && rise > 0.13 && u > s_.cowl_u && u < s_.side_glass_end_u) {
      const int step = row - (kLower - 1);
      if (step >= kSide - 1) return Kind::paint;  // roof rail
      const double start = s_.cowl_u + 0.03 + 0.030 * step, end = s_.side_glass_end_u - 0.012 * step;
      if (u < start || u > end) return Kind::paint;
      const double b_post = std::lerp(s_.roof_front_u, s_.roof_rear_u, 0.34);
      const double c_post = std::lerp(s_.roof_front_u, s_.roof_rear_u, 0.88);
      if (std::abs(u - b_post) < post || std::abs(u - c_post) < post) return Kind::trim;
      return Kind::glass;
    }
    return Kind::paint;
  }

  // Stations: dense where the profile bends and at the ends.
  std::vector<double> stations() const {
    std::vector<double> us = {0, 0.004, 0.010, 0.020, 0.034, 0.05, 0.95, 0.966, 0.98, 0.99, 0.996, 1};
    for (int i = 1; i < kStations; ++i) us.push_back(static_cast<double>(i) / kStations);
    for (double u : {s_.cowl_u, s_.roof_front_u, s_.roof_rear_u, s_.window_foot_u}) us.push_back(u);
    std::sort(us.begin(), us.end());
    std::vector<double> kept = {us.front()};
    for (double u : us)
      if (u - kept.back() > 0.0035) kept.push_back(u);
    kept.back() = 1;
    return kept;
  }

 private:
  BodyShape s_;
  std::vector<Vec2d> top_;
};

// Copies the listed faces of `all` with only the vertices they use.
Mesh part_of(const Mesh& all, const std::vector<Face>& faces) {
  Mesh part;
  std::vector<int> place(all.vertices.size(), -1);
  for (Face f : faces) {
    for (int& v : f) {
      if (place[as_size(v)] < 0) {
        place[as_size(v)] = static_cast<int>(part.vertices.size());
        part.vertices.push_back(all.vertices[as_size(v)]);
      }
      v = place[as_size(v)];
    }
    part.faces.push_back(f);
  }
  return part;
}

}  // namespace

Hull loft(const BodyShape& shape) {
  const Loft body(shape);
  const std::vector<double> us = body.stations();
  constexpr int ring = 2 * kHalf - 2;  // bottom and top middles are shared by both halves
  Hull hull;
  Mesh& all = hull.all;
  std::vector<double> rises;
  for (double u : us) {
    const Section s = body.section(u);
    rises.push_back(s.rise);
    // The ends lean: the nose's and tail's mid-height stands out, the rest draws back a little.
    const double x0 = shape.x_at(u);
    const double end = u < 0.5 ? smoothstep(0.05, 0, u) : -smoothstep(0.95, 1, u);
    for (int i = 0; i < ring; ++i) {
      const int j = i < kHalf ? i : ring - i;
      const Vec2d& p = s.points[as_size(j)];
      const double z = p.y() / shape.height;
      const double lean = end * 0.035 * shape.length * std::pow(std::abs(z - 0.33) / 0.33, 2.0);
      all.vertices.push_back({x0 - lean, i < kHalf ? p.x() : -p.x(), p.y()});
    }
  }
  std::vector<Face> paint, glass, trim;
  const int count = static_cast<int>(us.size());
  for (int k = 0; k + 1 < count; ++k)
    for (int i = 0; i < ring; ++i) {
      const int i2 = (i + 1) % ring;
      const int a = k * ring + i, b = k * ring + i2, c = (k + 1) * ring + i2, d = (k + 1) * ring + i;
      const int row = i < kHalf - 1 ? i : ring - 1 - i;
      const auto kind = body.kind(0.5 * (us[as_size(k)] + us[as_size(k + 1)]), row,
                                  0.5 * (rises[as_size(k)] + rises[as_size(k + 1)]));
      auto& list = kind == Loft::Kind::paint ? paint : kind == Loft::Kind::glass ? glass : trim;
      list.insert(list.end(), {{a, c, b}, {a, d, c}});
      all.faces.insert(all.faces.end(), {{a, c, b}, {a, d, c}});
    }
  for (int end = 0; end < 2; ++end) {
    const int first = end == 0 ? 0 : (count - 1) * ring;
    // Strips across the panel, not a fan: it is bent by the lean.
    for (int j = 0; j + 1 < kHalf; ++j) {
      const int a = first + j, b = first + j + 1, c = first + (ring - j - 1) % ring,
                d = first + (ring - j) % ring;
      const auto add = [&](int p, int q, int r) {
        if (p == q || q == r || p == r) return;
        const Face f = end == 0 ? Face{p, q, r} : Face{p, r, q};
        paint.push_back(f);
        all.faces.push_back(f);
      };
      add(a, b, c);
      add(a, c, d);
    }
  }
  hull.paint = part_of(all, paint);
  hull.glass = part_of(all, glass);
  hull.trim = part_of(all, trim);
  return hull;
}

double top_at(const Mesh& hull, double x, double y) {
  double z = 0;
  for (const Vec3d& v : hull.vertices)
    if (std::abs(v.x() - x) < 0.06 && std::abs(v.y() - y) < 0.14) z = std::max(z, v.z());
  return z;
}

Mesh patch(const Mesh& hull, int axis, int side, const Vec2d& low, const Vec2d& high, double lift,
           int columns, int rows) {
  const int across = 1 - axis;
  const std::size_t count = as_size((columns + 1) * (rows + 1));
  std::vector<double> depth(count, -1e9);
  std::vector<Vec2d> grid;
  for (int r = 0; r <= rows; ++r)
    for (int c = 0; c <= columns; ++c)
      grid.push_back({std::lerp(low.x(), high.x(), static_cast<double>(c) / columns),
                      std::lerp(low.y(), high.y(), static_cast<double>(r) / rows)});
  for (const Face& f : hull.faces) {
    const auto [a, b, d] = hull.corners(f);
    const Vec2d pa(a[across], a.z()), pb(b[across], b.z()), pd(d[across], d.z());
    const Vec2d least = pa.cwiseMin(pb).cwiseMin(pd), most = pa.cwiseMax(pb).cwiseMax(pd);
    if ((least.array() > high.array() + 1e-9).any() || (most.array() < low.array() - 1e-9).any()) continue;
    const double area = cross(pb - pa, pd - pa);
    if (std::abs(area) < 1e-12) continue;
    for (std::size_t i = 0; i < count; ++i) {  // grid points in the triangle projected along the axis
      const Vec2d& p = grid[i];
      const double b1 = cross(p - pa, pd - pa) / area, b2 = cross(pb - pa, p - pa) / area;
      if (b1 < -1e-9 || b2 < -1e-9 || b1 + b2 > 1 + 1e-9) continue;
      double& best = depth[i];
      best = std::max(best, side * ((1 - b1 - b2) * a[axis] + b1 * b[axis] + b2 * d[axis]));
    }
  }
  std::vector<Vec3d> points(depth.size());
  for (std::size_t i = 0; i < depth.size(); ++i) {
    if (depth[i] < -1e8) depth[i] = std::numeric_limits<double>::quiet_NaN();
    points[i][axis] = side * (depth[i] + lift);
    points[i][across] = grid[i].x();
    points[i].z() = grid[i].y();
  }
  Mesh mesh;
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < columns; ++c) {
      const std::size_t i = as_size(r) * as_size(columns + 1) + as_size(c), j = i + as_size(columns) + 1;
      if (std::isnan(depth[i] + depth[i + 1] + depth[j] + depth[j + 1])) continue;
      add_quad(mesh, points[i], points[i + 1], points[j + 1], points[j]);
    }
  return mesh;
}

}  // namespace mirage::generator

namespace mirage {
namespace {

struct StyleRange {
  double low, high;
  double draw(RandomStream& random) const { return random.uniform(low, high); }
};

// Makers' dimensions of cars sold in Europe and North America. Lengths in m; `_u` and overhangs are shares of
// the length from the front, the rest of the profile shares of the height.
struct Style {
  std::string_view name;
  StyleRange length, width, height;
  StyleRange overhang, wheelbase;  // front overhang to the axle; axle to axle
  StyleRange nose, bonnet, cowl_u, cowl;
  StyleRange roof_front_u, roof_peak, roof_rear_u,
      roof_rear;  // roof_peak: share of the way between front and rear
  StyleRange window_foot_u, window_foot, tail;
  StyleRange clearance, belt, belt_rise, wheel, tumblehome;
  StyleRange nose_round, tail_round;
};

constexpr std::array<Style, 7> kStyles = {{
    {"hatchback",  {3.35, 4.35}, {1.55, 1.82},   {1.40, 1.62}, {0.165, 0.205}, {0.61, 0.68},
     {0.42, 0.50}, {0.48, 0.56}, {0.18, 0.28},   {0.60, 0.68}, {0.36, 0.45},   {0.25, 0.5},
     {0.82, 0.93}, {0.91, 0.98}, {0.955, 0.985}, {0.57, 0.68}, {0.54, 0.65},   {0.09, 0.15},
     {0.55, 0.62}, {0.0, 0.06},  {0.27, 0.34},   {0.12, 0.20}, {0.18, 0.40},   {0.06, 0.22}},
    {"saloon",     {4.05, 5.10}, {1.62, 1.92}, {1.36, 1.52}, {0.165, 0.205}, {0.58, 0.625},
     {0.43, 0.51}, {0.49, 0.56}, {0.23, 0.29}, {0.61, 0.68}, {0.38, 0.445},  {0.25, 0.5},
     {0.65, 0.76}, {0.92, 0.98}, {0.80, 0.89}, {0.64, 0.73}, {0.60, 0.70},   {0.08, 0.13},
     {0.58, 0.64}, {0.0, 0.05},  {0.29, 0.36}, {0.14, 0.22}, {0.18, 0.40},   {0.10, 0.28}},
    {"estate",     {4.15, 5.05}, {1.62, 1.90},   {1.40, 1.58}, {0.165, 0.205}, {0.58, 0.63},
     {0.43, 0.51}, {0.48, 0.56}, {0.22, 0.29},   {0.61, 0.68}, {0.37, 0.44},   {0.2, 0.45},
     {0.87, 0.95}, {0.89, 0.97}, {0.965, 0.985}, {0.59, 0.69}, {0.56, 0.66},   {0.09, 0.14},
     {0.56, 0.63}, {0.0, 0.06},  {0.29, 0.36},   {0.12, 0.20}, {0.18, 0.40},   {0.06, 0.20}},
    {"suv",        {3.95, 5.10}, {1.70, 2.05},  {1.55, 1.95}, {0.165, 0.205}, {0.585, 0.64},
     {0.48, 0.58}, {0.53, 0.62}, {0.20, 0.28},  {0.62, 0.70}, {0.34, 0.43},   {0.2, 0.5},
     {0.86, 0.95}, {0.91, 0.98}, {0.96, 0.985}, {0.58, 0.70}, {0.56, 0.67},   {0.12, 0.19},
     {0.57, 0.66}, {0.0, 0.06},  {0.33, 0.42},  {0.09, 0.18}, {0.14, 0.34},   {0.05, 0.18}},
    {"van",        {3.90, 5.90}, {1.65, 2.05},  {1.58, 2.50}, {0.155, 0.205}, {0.56, 0.66},
     {0.36, 0.48}, {0.42, 0.54}, {0.12, 0.22},  {0.52, 0.64}, {0.24, 0.40},   {0.2, 0.5},
     {0.89, 0.97}, {0.94, 0.99}, {0.97, 0.988}, {0.50, 0.62}, {0.48, 0.60},   {0.08, 0.14},
     {0.49, 0.60}, {0.0, 0.05},  {0.29, 0.36},  {0.06, 0.16}, {0.14, 0.34},   {0.03, 0.14}},
    {"pick-up",    {4.80, 6.00},  {1.72, 2.05}, {1.68, 1.98}, {0.155, 0.190}, {0.58, 0.65},
     {0.46, 0.56}, {0.52, 0.60},  {0.20, 0.26}, {0.60, 0.67}, {0.31, 0.38},   {0.25, 0.5},
     {0.52, 0.66}, {0.94, 0.985}, {0.57, 0.69}, {0.58, 0.66}, {0.58, 0.64},   {0.14, 0.20},
     {0.54, 0.61}, {0.0, 0.03},   {0.35, 0.42}, {0.10, 0.18}, {0.14, 0.30},   {0.03, 0.12}},
    {"coupe",      {3.95, 4.90}, {1.66, 1.95},  {1.22, 1.42}, {0.175, 0.215}, {0.56, 0.61},
     {0.44, 0.52}, {0.50, 0.58}, {0.27, 0.36},  {0.62, 0.70}, {0.41, 0.51},   {0.2, 0.45},
     {0.62, 0.76}, {0.90, 0.97}, {0.86, 0.965}, {0.62, 0.73}, {0.60, 0.70},   {0.07, 0.12},
     {0.58, 0.66}, {0.0, 0.05},  {0.29, 0.36},  {0.16, 0.26}, {0.22, 0.45},   {0.14, 0.30}},
}};

constexpr double kTyreWidth = 0.2;  // m

}  // namespace

std::string_view name_of(BodyStyle style) {
  return kStyles[as_size(style)].name;
}

generator::BodyShape draw_body(BodyStyle style, RandomStream& random) {
  const Style& s = kStyles[as_size(style)];
  generator::BodyShape b;
  b.length = s.length.draw(random);
  // Long cars are wide: half of the width's place in its range follows the length.
  const double along = (b.length - s.length.low) / (s.length.high - s.length.low);
  b.width = std::lerp(s.width.low, s.width.high, 0.5 * (along + random.uniform()));
  b.height = s.height.draw(random);
  b.front_axle_u = s.overhang.draw(random);
  b.rear_axle_u = b.front_axle_u + s.wheelbase.draw(random);
  b.nose = s.nose.draw(random);
  b.bonnet = std::max(b.nose + 0.02, s.bonnet.draw(random));
  b.cowl_u = s.cowl_u.draw(random);
  b.cowl = std::max(b.bonnet + 0.03, s.cowl.draw(random));
  b.roof_front_u = std::max(b.cowl_u + 0.10, s.roof_front_u.draw(random));
  b.roof_rear_u = std::max(b.roof_front_u + 0.12, s.roof_rear_u.draw(random));
  b.roof_peak_u = std::lerp(b.roof_front_u, b.roof_rear_u, s.roof_peak.draw(random));
  b.roof_rear = s.roof_rear.draw(random);
  b.window_foot_u = std::min(0.988, std::max(b.roof_rear_u + 0.025, s.window_foot_u.draw(random)));
  b.window_foot = s.window_foot.draw(random);
  b.tail = std::min(b.window_foot - 0.005, s.tail.draw(random));
  b.clearance = s.clearance.draw(random);
  b.belt_front = s.belt.draw(random);
  b.belt_rear = b.belt_front + s.belt_rise.draw(random);
  b.wheel_radius = s.wheel.draw(random);
  b.tumblehome = s.tumblehome.draw(random);
  b.nose_round = s.nose_round.draw(random);
  b.tail_round = s.tail_round.draw(random);
  return b;
}

Mesh car_mesh(const generator::BodyShape& body) {
  Mesh mesh = generator::loft(body).all;
  const Mesh hull = mesh;
  for (double u : {body.front_axle_u, body.rear_axle_u}) {
    const double x = body.x_at(u), r = body.wheel_radius;
    double y = 0;  // the body's outermost point over the wheel
    for (const Vec3d& v : hull.vertices)
      if (std::abs(v.x() - x) < r && v.z() < 3 * r) y = std::max(y, v.y());
    for (int side : {1, -1})
      generator::add_wheel(mesh, {x, side * (y + 0.006 - kTyreWidth), r}, r, kTyreWidth, 22, -side);
  }
  const Eigen::AlignedBox3d box = bounds(mesh);
  const Vec3d shift(-box.center().x(), -box.center().y(), -box.min().z());
  for (Vec3d& v : mesh.vertices) v += shift;
  return mesh;
}

std::vector<ShapeSample> family_samples(int each, std::uint64_t seed) {
  std::vector<ShapeSample> samples;
  for (BodyStyle style : kBodyStyles)
    for (int i = 0; i < each; ++i) {
      RandomStream random(seed, "car family", 1000000 * static_cast<std::uint64_t>(style) + as_size(i));
      samples.push_back({car_mesh(draw_body(style, random)), std::string(name_of(style))});
    }
  return samples;
}

}  // namespace mirage
