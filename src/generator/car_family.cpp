#include "generator/car_family.h"

#include <cmath>
#include <numbers>

#include "geometry/shapes.h"

namespace mirage {
namespace {

struct Interval {
  double low, high;
  double draw(RandomStream& random) const { return random.uniform(low, high); }
};

// Makers' dimensions of cars sold in Europe and North America. Lengths in m; `_u` and overhangs are shares of
// the length from the front, the rest of the profile shares of the height.
struct Style {
  std::string_view name;
  Interval length, width, height;
  Interval overhang, wheelbase;  // front overhang to the axle; axle to axle
  Interval nose, bonnet, cowl_u, cowl;
  Interval roof_front_u, roof_peak, roof_rear_u,
      roof_rear;  // roof_peak: share of the way between front and rear
  Interval window_foot_u, window_foot, tail;
  Interval clearance, belt, belt_rise, wheel, tumblehome;
  Interval nose_round, tail_round;
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
  return kStyles[static_cast<std::size_t>(style)].name;
}

generator::BodyShape draw_body(BodyStyle style, RandomStream& random) {
  const Style& s = kStyles[static_cast<std::size_t>(style)];
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
    const double x = body.length * (0.5 - u), r = body.wheel_radius;
    double y = 0;  // the body's outermost point over the wheel
    for (const Vec3d& v : hull.vertices)
      if (std::abs(v.x() - x) < r && v.z() < 3 * r) y = std::max(y, v.y());
    for (int side : {1, -1})
      append(mesh, generator::cylinder(r, kTyreWidth, 22),
             Transform(Eigen::Translation3d(x, side * (y + 0.006 - kTyreWidth), r) *
                       Eigen::AngleAxisd(-side * 0.5 * std::numbers::pi, Vec3d::UnitX())));
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
      RandomStream random(seed, "car family", 1000000 * static_cast<std::uint64_t>(style) + i);
      samples.push_back({car_mesh(draw_body(style, random)), std::string(name_of(style))});
    }
  return samples;
}

}  // namespace mirage
