// Plants, fences and ground that every look uses.
#include "generator/street_site.h"
#include "geometry/shapes.h"

namespace mirage::generator {

void StreetSite::add_fence(double s0, double s1, double d) {
  const int style = random_.below(5);
  const double h = u(0.8, 1.9);
  Mesh mesh, leaves;
  Material m = plain(Vec3f::Constant(f(0.03, 0.3)), 0.3f);
  const auto panel = [&](double a, double b, double low, double high) {
    add_quad(mesh, on_ground(a, d, low), on_ground(b, d, low), on_ground(b, d, high), on_ground(a, d, high));
  };
  for (double s = s0; s < s1; s += 2) {
    if (in_cross(s, 3)) continue;
    const double e = std::min(s + 2, s1);
    if (style >= 3) {  // clipped hedge
      for (double side : {-0.3, 0.3}) {
        add_quad(mesh, on_ground(s, d + side), on_ground(e, d + side), on_ground(e, d + side, h - 0.06),
                 on_ground(s, d + side, h - 0.06));
        for (int i = 0; i < (s < 30 ? 160 : 50); ++i)
          add_leaves(leaves, on_ground(u(s, e), d + side * u(0.9, 1.15), u(0.02, 1.02) * h),
                     {0.04, 0.04, 0.04}, 1, s < 30 ? 0.06 : 0.11, random_);
      }
      add_quad(mesh, on_ground(s, d - 0.3, h - 0.06), on_ground(e, d - 0.3, h - 0.06),
               on_ground(e, d + 0.3, h - 0.06), on_ground(s, d + 0.3, h - 0.06));
      continue;
    }
    panel(s, s + 0.07, 0, h);
    if (style == 0) {  // wall
      panel(s, e, 0, h);
    } else if (style == 1) {  // rails
      panel(s, e, 0.15, 0.22);
      panel(s, e, h - 0.12, h - 0.05);
      for (double x = s + 0.18; x < e; x += 0.18) panel(x, x + 0.03, 0.15, h);
    } else {  // boards
      for (double x = s; x < e; x += 0.14) panel(x, x + 0.115, 0.05, h);
    }
  }
  if (style == 0 && chance(0.5))
    m.pattern = Pattern::brick, m.albedo = Vec3f(0.3f, 0.13f, 0.09f), m.second = Vec3f::Constant(0.35f);
  if (style == 2) m.albedo = Vec3f(f(0.08, 0.25), f(0.06, 0.16), 0.06f);
  if (style >= 3) {
    m.pattern = Pattern::foliage, m.albedo = Vec3f(f(0.025, 0.05), f(0.05, 0.09), 0.018f);
    m.second = Vec3f(f(0.05, 0.09), f(0.08, 0.13), 0.025f), m.variant = random_.next_u32();
    surfaces_.push_back(surface(leaves, m));
    m.albedo *= 0.4f, m.second *= 0.4f;
  }
  surfaces_.push_back(surface(mesh, m));
}

void StreetSite::add_woods(int side, double from) {
  const double sign = side ? 1 : -1;
  Mesh leaves, trunks, cores;
  for (double s = -5; s < far_ + 10; s += 3) {
    if (in_cross(s, 2)) continue;
    for (int k = 0; k < 2; ++k) {
      const double d = sign * (from + u(0, 10));
      const Vec3d p = on_ground(s, d);
      const double h = u(4, 12);
      const int count = s < 15 ? 1300 : s < 40 ? 600 : 180;
      const double size = s < 15 ? 0.11 : s < 40 ? 0.17 : 0.34;
      const Vec3d crown = p + Vec3d(0, 0, 0.55 * h);
      add_leaves(leaves, crown, {2.4, 2.4, 0.48 * h}, count, size, random_);
      append(cores, ellipsoid({1.3, 1.3, 0.3 * h}), at(crown.x(), crown.y(), crown.z()));
      if (s < 40) append(trunks, cylinder(u(0.08, 0.2), 0.7 * h, 7), at(p.x(), p.y(), p.z()));
    }
  }
  Material m = plain(Vec3f(f(0.03, 0.06), f(0.055, 0.1), 0.02f), 0.35f);
  m.pattern = Pattern::foliage, m.second = Vec3f(f(0.06, 0.14), f(0.09, 0.13), 0.03f),
  m.variant = random_.next_u32();
  surfaces_.push_back(surface(leaves, m));
  m.albedo *= 0.35f, m.second *= 0.35f;
  surfaces_.push_back(surface(cores, m));
  surfaces_.push_back(surface(trunks, plain(Vec3f(0.07f, 0.055f, 0.045f), 0.3f)));
}

void StreetSite::add_earth() {
  Mesh earth;
  for (double d = -80; d < 79; d += 8) add_strip(earth, d, d + 8, -12, far_ + 30, 4, -0.35);
  surfaces_.push_back(surface(earth, plain(Vec3f(0.07f, 0.065f, 0.05f), 0.3f)));
}

void StreetSite::add_manhole_covers(int count) {
  Mesh covers;
  for (int i = 0; i < count; ++i) {
    const Vec3d p = on_ground(u(4, 40), u(-half_[0], half_[1]) * 0.8, 0.006);
    append(covers, cylinder(0.32, 0.004, 18), at(p.x(), p.y(), p.z()));
  }
  surfaces_.push_back(surface(covers, plain(Vec3f::Constant(0.045f), 0.2f)));
}

}  // namespace mirage::generator
