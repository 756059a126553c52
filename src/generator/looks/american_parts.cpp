// Street furniture of the North American look.
#include "generator/looks/american_parts.h"

#include <array>
#include <cmath>

#include "base/sizes.h"

namespace mirage::generator::american {
namespace {

using namespace sign_color;

void add_post(Actor& actor, double height) {
  actor.add(cylinder(0.03, height, 10), plain(kGrey, 0.35f, 0.02f));
}

}  // namespace

void add_letters(Mesh& mesh, double x, double y0, double y1, double z, double height, RandomStream& random) {
  // Letters from strokes: left, right, top, middle, bottom.
  constexpr std::array<unsigned, 12> letters = {0b11110, 0b10111, 0b10101, 0b11101, 0b10111, 0b11000,
                                                0b10001, 0b11111, 0b00100, 0b11011, 0b01111, 0b10110};
  const double pitch = 0.75 * height, stroke = 0.17 * height, direction = y1 < y0 ? -1 : 1;
  const int count = static_cast<int>(std::abs(y1 - y0) / pitch);
  for (int i = 0; i < count; ++i) {
    const unsigned shape = letters[as_size(random.below(12))];
    if (i > 0 && i + 1 < count && random.uniform() < 0.12) continue;  // a gap between words
    const double a = y0 + direction * pitch * (i + 0.1), b = y0 + direction * pitch * (i + 0.82);
    const auto bar = [&](double s0, double s1, double t0, double t1) {
      const double ya = std::lerp(a, b, s0), yb = std::lerp(a, b, s1), za = z + (t0 - 0.5) * height,
                   zb = z + (t1 - 0.5) * height;
      add_quad(mesh, {x, ya, za}, {x, yb, za}, {x, yb, zb}, {x, ya, zb});
    };
    const double w = stroke / (0.72 * pitch), h = stroke / height;
    if (shape & 16) bar(0, w, 0, 1);
    if (shape & 8) bar(1 - w, 1, 0, 1);
    if (shape & 4) bar(0, 1, 1 - h, 1);
    if (shape & 2) bar(0, 1, 0.5 - 0.5 * h, 0.5 + 0.5 * h);
    if (shape & 1) bar(0, 1, 0, h);
  }
}

void add_signal_head(Actor& actor, double y, double z, int lit, bool yellow) {
  Mesh housing, plate, hoods;
  add_box(housing, {-0.12, y - 0.17, z - 0.53}, {0.10, y + 0.17, z + 0.53});
  add_quad(plate, {0.0, y - 0.32, z - 0.68}, {0.0, y + 0.32, z - 0.68}, {0.0, y + 0.32, z + 0.68},
           {0.0, y - 0.32, z + 0.68});
  add_signal_lamps(actor, hoods, {{-0.12, y, z + 0.35}, 0.35, 0.14, 0.155, 0.2}, lit);
  const Material black = plain(Vec3f::Constant(0.015f), 0.15f, 0.02f);
  const Material paint = yellow ? plain(Vec3f(0.55f, 0.33f, 0.015f), 0.4f, 0.02f) : black;
  actor.add(housing, paint);
  actor.add(hoods, paint);
  actor.add(plate, black);
}

Actor make_mast_arm(RandomStream& random, double reach, const std::vector<double>& heads, int lit) {
  Actor arm;
  const double h = random.uniform(5.9, 6.6);
  const bool yellow = random.uniform() < 0.5;
  Mesh steel = cylinder(0.16, h + 0.3, 14, 0.11), board, letters;
  for (int i = 0; i < 6; ++i) {  // the arm rises a little and tapers
    const double a = i / 6.0, b = (i + 1) / 6.0;
    add_rod(steel, {0, reach * a, h - 0.3 + 0.35 * std::sqrt(a)},
            {0, reach * b, h - 0.3 + 0.35 * std::sqrt(b)}, 0.11 - 0.05 * a);
  }
  for (double y : heads)
    add_signal_head(arm, y, h - 0.05 - 0.45 + 0.35 * std::sqrt(std::min(1.0, y / reach)), lit, yellow);
  add_signal_head(arm, 0.25, 3.3, lit, yellow);  // at the pole, for those who stand under the arm
  const double y = std::min(0.35 * reach, 2.4);
  add_box(board, {-0.05, y - 0.95, h - 0.55}, {-0.02, y + 0.95, h - 0.1});
  add_letters(letters, -0.055, y + 0.85, y - 0.85, h - 0.325, 0.24, random);
  arm.add(steel, plain(Vec3f::Constant(random.uniform() < 0.5 ? 0.3f : 0.06f), 0.35f, 0.02f));
  arm.add(board, plain(kGreen, 2.f));
  arm.add(letters, plain(kWhite, 2.f));
  return arm;
}

Actor make_utility_pole(RandomStream& random, double height) {
  Actor pole;
  Mesh wood = cylinder(0.17, height, 12, 0.11), glass, tank;
  add_box(wood, {-0.06, -1.25, height - 0.7}, {0.06, 1.25, height - 0.57});
  for (double y : {-1.05, 0.6, 1.05}) append(glass, cylinder(0.05, 0.16, 8), at(0, y, height - 0.57));
  if (random.uniform() < 0.35) append(tank, cylinder(0.26, 0.9, 14), at(0.1, -0.42, height - 2.2));
  Material bark = plain(Vec3f(0.13f, 0.095f, 0.065f) * static_cast<float>(random.uniform(0.6, 1.2)), 0.3f);
  bark.pattern = Pattern::bark, bark.variant = random.next_u32();
  pole.surfaces = {surface(wood, bark), surface(glass, plain(Vec3f::Constant(0.25f), 0.3f, 0.03f)),
                   surface(tank, plain(Vec3f::Constant(0.35f), 0.4f, 0.01f))};
  return pole;
}

Actor make_street_lamp(RandomStream& random) {
  Actor lamp;
  const double h = random.uniform(7.5, 10), reach = random.uniform(1.6, 2.8);
  Mesh steel = cylinder(0.1, h, 12, 0.06), head;
  add_rod(steel, {0, 0, h - 0.3}, {0, reach, h + 0.3}, 0.035);
  add_box(head, {-0.14, reach - 0.1, h + 0.25}, {0.14, reach + 0.65, h + 0.37});
  const Vec3f tone = Vec3f::Constant(static_cast<float>(random.uniform(0.06, 0.4)));
  lamp.surfaces = {surface(steel, plain(tone, 0.35f, 0.02f)), surface(head, plain(tone, 0.35f, 0.02f))};
  return lamp;
}

Actor make_stop_sign(RandomStream& random) {
  Actor actor;
  const double z = random.uniform(2.1, 2.4), r = 0.40;
  add_post(actor, z + 0.35);
  SignBoard sign(actor, -0.04, z);
  sign.polygon(8, r, kPi / 8, kGrey, 0.012), sign.polygon(8, r, kPi / 8, kWhite),
      sign.polygon(8, 0.93 * r, kPi / 8, kRed);
  Mesh letters;
  for (int i = 0; i < 4; ++i) {
    const double y = (0.72 - 0.38 * i) * r;
    add_quad(letters, {-0.075, y, z - 0.1}, {-0.075, y - 0.24 * r, z - 0.1}, {-0.075, y - 0.24 * r, z + 0.1},
             {-0.075, y, z + 0.1});
  }
  actor.add(letters, plain(kWhite, 2.f));
  return actor;
}

Actor make_sign(RandomStream& random) {
  const int kind = 1 + random.below(5);
  Actor actor;
  const double z = random.uniform(2.0, 2.5);
  add_post(actor, z + 0.4);
  SignBoard sign(actor, -0.04, z);
  Mesh text;
  const auto rectangle = [&](double w, double h, const Vec3f& edge, const Vec3f& inner) {
    sign.bar(-0.5 * w, -0.5 * h, 0.5 * w, 0.5 * h, edge);
    sign.bar(-0.5 * w + 0.02, -0.5 * h + 0.02, 0.5 * w - 0.02, 0.5 * h - 0.02, inner);
  };
  Vec3f ink = kBlack;
  switch (kind) {
    case 1:  // speed limit
      rectangle(0.6, 0.75, kBlack, kWhite);
      add_letters(text, -0.06, 0.24, -0.24, z + 0.27, 0.09, random),
          add_letters(text, -0.06, 0.24, -0.24, z + 0.14, 0.09, random);
      add_letters(text, -0.06, 0.24, -0.26, z - 0.12, 0.32, random);
      break;
    case 2:
    case 3: {  // warning
      sign.polygon(4, 0.52, 0, kGrey, 0.012), sign.polygon(4, 0.52, 0, kBlack),
          sign.polygon(4, 0.49, 0, kYellow);
      add_quad(text, {-0.075, 0.05, z - 0.2}, {-0.075, -0.05, z - 0.2}, {-0.075, -0.05, z + 0.12},
               {-0.075, 0.05, z + 0.12});
      add_quad(text, {-0.075, 0.15, z + 0.1}, {-0.075, -0.15, z + 0.1}, {-0.075, 0, z + 0.26},
               {-0.075, 0, z + 0.26});
      break;
    }
    case 4:  // no parking
      rectangle(0.32, 0.46, kRed, kWhite);
      add_letters(text, -0.06, 0.12, -0.12, z + 0.1, 0.11, random),
          add_letters(text, -0.06, 0.12, -0.12, z - 0.08, 0.07, random);
      ink = kRed;
      break;
    default:  // street names: two crossed blades over the post
      for (double turn : {0.0, 0.5}) {
        const Transform t = at(0, 0, z + 0.5 + 0.24 * turn, kPi * turn);
        Mesh blade, name;
        add_box(blade, {-0.012, -0.5, 0}, {0.012, 0.5, 0.2});
        add_letters(name, -0.016, 0.44, -0.44, 0.1, 0.11, random);
        actor.add(moved(blade, t), plain(kGreen, 2.f));
        actor.add(moved(name, t), plain(kWhite, 2.f));
      }
  }
  actor.add(text, plain(ink, 1.f));
  return actor;
}

Actor make_hydrant(RandomStream& random) {
  Actor hydrant;
  Mesh body = cylinder(0.17, 0.06, 14), caps;
  append(body, cylinder(0.12, 0.55, 14), Transform::Identity());
  append(body, ellipsoid({0.14, 0.14, 0.13}, 2), at(0, 0, 0.56));
  append(body, cylinder(0.03, 0.12, 8), at(0, 0, 0.64));
  add_rod(caps, {0, -0.21, 0.42}, {0, 0.21, 0.42}, 0.06);
  add_rod(caps, {-0.2, 0, 0.38}, {0, 0, 0.38}, 0.075);
  const bool yellow = random.uniform() < 0.4;
  const Material paint = plain(yellow ? Vec3f(0.6f, 0.38f, 0.02f) : Vec3f(0.45f, 0.02f, 0.02f), 0.5f, 0.02f);
  hydrant.surfaces = {
      surface(body, paint, true),
      surface(caps, random.uniform() < 0.4 ? plain(Vec3f::Constant(0.5f), 0.5f, 0.02f) : paint)};
  return hydrant;
}

Actor make_pylon(RandomStream& random) {
  Actor pylon;
  Mesh posts, board, trim, letters;
  const double h = random.uniform(5, 9), w = random.uniform(1.6, 3.2), tall = random.uniform(1.2, 2.4);
  const bool twin = random.uniform() < 0.5;
  for (double y : {-0.35 * w, 0.35 * w})
    append(posts, cylinder(twin ? 0.1 : 0.18, h, 10), at(0, twin ? y : 0, 0));
  add_box(board, {-0.18, -0.5 * w, h - tall}, {0.18, 0.5 * w, h});
  add_box(trim, {-0.22, -0.54 * w, h}, {0.22, 0.54 * w, h + 0.12});
  const auto tone = [&](double high) { return static_cast<float>(random.uniform(0.02, high)); };
  Vec3f color(0.65f, 0.64f, 0.6f);
  if (random.uniform() >= 0.3) {
    const float blue = tone(0.45), green = tone(0.35);
    color = Vec3f(tone(0.55), green, blue);
  }
  for (int line = 0; line < 2; ++line)
    for (double x : {-0.19, 0.19})
      add_letters(letters, x, x < 0 ? 0.44 * w : -0.44 * w, x < 0 ? -0.44 * w : 0.44 * w,
                  h - tall * (line == 0 ? 0.33 : 0.74), tall * (line == 0 ? 0.36 : 0.2), random);
  pylon.surfaces = {
      surface(posts, plain(Vec3f::Constant(0.2f), 0.35f, 0.02f)), surface(board, plain(color, 0.5f, 0.02f)),
      surface(trim, plain(Vec3f::Constant(0.1f), 0.3f)),
      surface(letters,
              plain(color.mean() < 0.25f ? Vec3f(0.7f, 0.68f, 0.6f) : Vec3f(0.3f, 0.02f, 0.02f), 0.5f))};
  return pylon;
}

Actor make_kerb_item(RandomStream& random) {
  Actor item;
  Mesh a, b;
  switch (random.below(4)) {
    case 0:  // collection box: blue, round top
      add_box(a, {-0.25, -0.3, 0.15}, {0.25, 0.3, 1.0});
      add_rod(a, {0, -0.3, 1.0}, {0, 0.3, 1.0}, 0.25);
      item.surfaces = {surface(a, plain(Vec3f(0.01f, 0.04f, 0.2f), 0.4f, 0.02f))};
      break;
    case 1:  // wheeled bins at the kerb
      for (int i = 0; i < 2; ++i) {
        add_box(a, {-0.3, 0.75 * i - 0.28, 0.08}, {0.3, 0.75 * i + 0.28, 1.0});
        add_box(b, {-0.34, 0.75 * i - 0.31, 1.0}, {0.34, 0.75 * i + 0.31, 1.07});
      }
      item.surfaces = {
          surface(a,
                  plain(random.uniform() < 0.5 ? Vec3f(0.02f, 0.06f, 0.2f) : Vec3f::Constant(0.05f), 0.2f)),
          surface(b, plain(Vec3f::Constant(0.03f), 0.2f))};
      break;
    case 2:  // bench
      add_box(a, {-0.25, -0.8, 0.4}, {0.2, 0.8, 0.46}), add_box(a, {0.2, -0.8, 0.4}, {0.26, 0.8, 0.9});
      for (double y : {-0.7, 0.7}) add_box(b, {-0.22, y - 0.04, 0}, {0.22, y + 0.04, 0.4});
      item.surfaces = {surface(a, plain(Vec3f(0.2f, 0.11f, 0.05f), 0.35f)),
                       surface(b, plain(Vec3f::Constant(0.03f), 0.2f))};
      break;
    default:  // newspaper boxes
      for (int i = 0; i < 3; ++i) {
        Mesh box;
        add_box(box, {-0.22, 0.55 * i - 0.24, 0.35}, {0.22, 0.55 * i + 0.24, 1.15});
        add_box(b, {-0.05, 0.55 * i - 0.05, 0}, {0.05, 0.55 * i + 0.05, 0.35});
        const float tone = static_cast<float>(random.uniform(0.05, 0.5));
        item.add(box, plain(i == 0   ? Vec3f(tone, 0.03f, 0.02f)
                            : i == 1 ? Vec3f(0.02f, 0.08f, tone)
                                     : Vec3f(tone, 0.7f * tone, 0.02f),
                            0.4f, 0.02f));
      }
      item.add(b, plain(Vec3f::Constant(0.1f), 0.3f));
  }
  fit_label_box(item);
  return item;
}

}  // namespace mirage::generator::american
