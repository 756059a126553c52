#include "generator/street.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "generator/looks/american.h"
#include "generator/looks/european.h"
#include "generator/sign_board.h"
#include "generator/street_site.h"
#include "geometry/shapes.h"

namespace mirage::generator {

bool on_roof(const Surface& surface, const Placed& placed) {
  const double top = placed.box.bottom + placed.box.height;
  return std::any_of(surface.mesh.vertices.begin(), surface.mesh.vertices.end(),
                     [&](const Vec3d& v) { return v.z() > top + 0.01; });
}

Street make_street(std::uint64_t seed, std::uint64_t index, double height, Look look, double behind) {
  if (look == Look::american) return AmericanStreet(seed, index, height).build(behind);
  return EuropeanStreet(seed, index, height).build(behind);
}

void StreetSite::go_on(double behind) {
  behind_ = ahead_ = behind;
  far_ = kFar + behind;
  if (behind > 0 && cross_s_ < kFar && chance(0.5)) cross_s_ += behind;  // before us, or behind
}

// Plants, fences and ground that every look uses.

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
        for (int i = 0; i < (away(s) < 30 ? 160 : 50); ++i) {
          const double up = u(0.02, 1.02) * h, across = d + side * u(0.9, 1.15);
          add_leaves(leaves, on_ground(u(s, e), across, up), {0.04, 0.04, 0.04}, 1,
                     away(s) < 30 ? 0.06 : 0.11, random_);
        }
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
      const int count = away(s) < 15 ? 1300 : away(s) < 40 ? 600 : 180;
      const double size = away(s) < 15 ? 0.11 : away(s) < 40 ? 0.17 : 0.34;
      const Vec3d crown = p + Vec3d(0, 0, 0.55 * h);
      add_leaves(leaves, crown, {2.4, 2.4, 0.48 * h}, count, size, random_);
      append(cores, ellipsoid({1.3, 1.3, 0.3 * h}), at(crown.x(), crown.y(), crown.z()));
      if (away(s) < 40) append(trunks, cylinder(u(0.08, 0.2), 0.7 * h, 7), at(p.x(), p.y(), p.z()));
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
    const double d = 0.8 * u(-half_[0], half_[1]);
    const Vec3d p = on_ground(u(4, 40), d, 0.006);
    append(covers, cylinder(0.32, 0.004, 18), at(p.x(), p.y(), p.z()));
  }
  surfaces_.push_back(surface(covers, plain(Vec3f::Constant(0.045f), 0.2f)));
}

// Poles, lamps, European road signs and traffic lights. All of them face −x: oncoming traffic reads them.

namespace {

using namespace sign_color;

void european_sign(Actor& pole, double x, double z, RandomStream& random) {
  SignBoard sign(pole, x, z);
  const double r = random.uniform(0.30, 0.42);
  const int kind = random.below(8);
  const auto back = [&](int corners, double radius, double turn) {
    sign.polygon(corners, radius, turn, kGrey, 0.012);
  };
  switch (kind) {
    case 0:  // warning
    case 1:  // give way
      back(3, 1.25 * r, kind * std::numbers::pi), sign.polygon(3, 1.25 * r, kind * std::numbers::pi, kRed);
      sign.polygon(3, 0.85 * r, kind * std::numbers::pi, kWhite);
      if (kind == 0) sign.bar(-0.035, -0.15 * r, 0.035, 0.4 * r, kBlack);
      break;
    case 2:  // speed limit
      back(24, r, 0), sign.polygon(24, r, 0, kRed), sign.polygon(24, 0.78 * r, 0, kWhite);
      for (double y : {0.08 * r, -0.52 * r}) {
        sign.bar(y, -0.4 * r, y + 0.42 * r, 0.4 * r, kBlack);
        sign.bar(y + 0.14 * r, -0.26 * r, y + 0.28 * r, 0.26 * r, kWhite);
      }
      break;
    case 3:  // no parking
      back(24, r, 0), sign.polygon(24, r, 0, kRed), sign.polygon(24, 0.82 * r, 0, kBlue);
      sign.slanted_bar(1.7 * r, 0.16 * r, 0.25 * std::numbers::pi, kRed);
      break;
    case 4:  // no entry
      back(24, r, 0), sign.polygon(24, r, 0, kRed), sign.bar(-0.7 * r, -0.13 * r, 0.7 * r, 0.13 * r, kWhite);
      break;
    case 5:  // priority road
      back(4, r, 0), sign.polygon(4, r, 0, kWhite), sign.polygon(4, 0.78 * r, 0, kYellow);
      break;
    case 6:  // stop
      back(8, r, std::numbers::pi / 8), sign.polygon(8, r, std::numbers::pi / 8, kRed);
      for (int i = 0; i < 4; ++i)
        sign.bar((-0.68 + 0.36 * i) * r, -0.2 * r, (-0.44 + 0.36 * i) * r, 0.2 * r, kWhite);
      break;
    default:  // parking
      back(4, 1.3 * r, 0.25 * std::numbers::pi), sign.polygon(4, 1.3 * r, 0.25 * std::numbers::pi, kBlue);
      sign.bar(0.12 * r, -0.6 * r, 0.34 * r, 0.6 * r, kWhite);
      sign.bar(-0.34 * r, 0.0, 0.12 * r, 0.6 * r, kWhite),
          sign.bar(-0.12 * r, 0.18 * r, 0.12 * r, 0.42 * r, kBlue);
  }
}

}  // namespace

Actor make_pole(RandomStream& random) {
  Actor pole;
  Mesh post, board;
  const double h = random.uniform(2.4, 8), r = h < 4 ? 0.035 : random.uniform(0.05, 0.09);
  append(post, cylinder(r, h, 10), Transform::Identity());
  if (h < 4) {
    european_sign(pole, -r - 0.01, h - 0.38, random);
  } else if (random.uniform() < 0.6) {
    add_box(post, {-0.05, -0.04, h - 0.1}, {1.3, 0.04, h});  // street lamp's arm
    add_box(board, {0.8, -0.12, h - 0.05}, {1.5, 0.12, h + 0.08});
  }
  pole.surfaces.push_back(
      surface(post, plain(Vec3f::Constant(static_cast<float>(random.uniform(0.08, 0.4))), 0.35f, 0.02f)));
  if (!board.faces.empty())
    pole.surfaces.push_back(surface(board, plain(Vec3f::Constant(0.5f), 0.3f, 0.01f)));
  return pole;
}

Actor make_traffic_light(RandomStream& random, int lit) {
  Actor light;
  const double foot = random.uniform(2.1, 2.5);
  Mesh post, housing;
  append(post, cylinder(0.06, foot + 1.0, 12), Transform::Identity());
  add_box(housing, {-0.30, -0.16, foot}, {-0.07, 0.16, foot + 0.96});
  const std::array<Vec3f, 3> dark = {Vec3f(0.10f, 0.01f, 0.01f), Vec3f(0.12f, 0.07f, 0.01f),
                                     Vec3f(0.01f, 0.08f, 0.05f)},
                             bright = {Vec3f(3.0f, 0.12f, 0.08f), Vec3f(3.0f, 1.3f, 0.05f),
                                       Vec3f(0.1f, 2.6f, 1.1f)};
  for (std::size_t k = 0; k < 3; ++k) {
    const double z = foot + 0.80 - 0.32 * static_cast<double>(k);
    Mesh lens;
    append(lens, cylinder(0.11, 0.01, 18),
           Transform(Eigen::Translation3d(-0.305, 0, z) *
                     Eigen::AngleAxisd(-0.5 * std::numbers::pi, Vec3d::UnitY())));
    Material glass = plain(dark[k], 0.3f, 0.03f);
    if (static_cast<int>(k) == lit) glass.emission = bright[k];
    light.surfaces.push_back(surface(lens, glass));
    for (int i = 0; i < 6; ++i) {  // hood
      const double a = std::numbers::pi * i / 6, b = std::numbers::pi * (i + 1) / 6, r = 0.13;
      const Vec3d p(-0.30, r * std::cos(a), z + r * std::sin(a)),
          q(-0.30, r * std::cos(b), z + r * std::sin(b));
      add_quad(housing, p, q, q - Vec3d(0.17, 0, 0), p - Vec3d(0.17, 0, 0));
    }
  }
  light.surfaces.push_back(surface(post, plain(sign_color::kGrey, 0.35f, 0.02f)));
  light.surfaces.push_back(surface(housing, plain(Vec3f::Constant(0.02f), 0.15f, 0.02f)));
  return light;
}

}  // namespace mirage::generator
