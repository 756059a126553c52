// Poles, lamps, European road signs and traffic lights. All of them face −x: oncoming traffic reads them.
#include <array>
#include <cmath>
#include <numbers>

#include "generator/sign_board.h"
#include "geometry/shapes.h"

namespace mirage::generator {
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
