// A lofted body with wheels, lamps, plates, wipers, rails, seats and mirrors.
#include <algorithm>
#include <array>
#include <cmath>

#include "generator/car_body.h"
#include "geometry/mesh.h"

namespace mirage::generator {
namespace {

struct Paint {
  Vec3f color;
  float lidar;
  double share;
};

// Paints of parked cars in central Europe: mostly silver, grey, black and white, some blue, red, green.
const std::array<Paint, 14> kPaints = {{
    {{0.42f, 0.43f, 0.44f}, 0.42f, 0.16},     // silver
    {{0.28f, 0.29f, 0.30f}, 0.36f, 0.08},     // light grey
    {{0.10f, 0.105f, 0.115f}, 0.25f, 0.10},   // dark grey
    {{0.012f, 0.012f, 0.013f}, 0.10f, 0.21},  // black
    {{0.70f, 0.70f, 0.68f}, 0.60f, 0.11},     // white
    {{0.015f, 0.035f, 0.13f}, 0.22f, 0.09},   // dark blue
    {{0.05f, 0.12f, 0.34f}, 0.30f, 0.05},     // blue
    {{0.36f, 0.02f, 0.018f}, 0.40f, 0.06},    // red
    {{0.16f, 0.012f, 0.02f}, 0.25f, 0.03},    // dark red
    {{0.015f, 0.07f, 0.04f}, 0.22f, 0.03},    // green
    {{0.30f, 0.26f, 0.18f}, 0.40f, 0.03},     // beige
    {{0.10f, 0.06f, 0.03f}, 0.25f, 0.01},     // brown
    {{0.60f, 0.45f, 0.04f}, 0.50f, 0.01},     // yellow
    {{0.18f, 0.30f, 0.38f}, 0.38f, 0.03},     // light blue
}};

Material window(RandomStream& random) {
  Material m = plain(Vec3f::Constant(0.01f), 0.25f, 0.05f);
  m.transparency = static_cast<float>(random.uniform(0.3, 0.65));
  return m;
}

const Material kArch = plain(Vec3f::Constant(0.006f), 0.05f);
const Material kPlate = plain(Vec3f(0.6f, 0.6f, 0.58f), 1.6f);
const Material kPlateBand = plain(Vec3f(0.01f, 0.05f, 0.35f), 1.2f);
const Material kAmber = plain(Vec3f(0.50f, 0.16f, 0.01f), 0.9f, 0.06f);
const Material kClear = plain(Vec3f(0.5f, 0.48f, 0.46f), 0.6f, 0.06f);

void add_axle(Actor& car, const Hull& hull, double x, double radius, bool alloy) {
  for (int side : {1, -1}) {
    // The body's outermost point over the wheel.
    double y = 0;
    for (const Vec3d& v : hull.all.vertices)
      if (std::abs(v.x() - x) < radius && v.z() < 3.2 * radius) y = std::max(y, side * v.y());
    const auto add_disc = [&](Mesh& mesh, double outwards, double r, double width, int segments) {
      add_wheel(mesh, {x, side * (y + outwards), radius}, r, width, segments, -side);
    };
    // A dark opening that stands a little over the side, cut at the sill.
    Mesh arch;
    const double r = 1.15 * radius;
    for (int i = 0; i < 14; ++i) {
      const double a = kPi * (-0.06 + 1.12 * i / 14), b = kPi * (-0.06 + 1.12 * (i + 1) / 14);
      const double yo = side * (y + 0.002);
      add_quad(arch, {x, yo, radius}, {x + r * std::cos(a), yo, radius + r * std::sin(a)},
               {x + r * std::cos(b), yo, radius + r * std::sin(b)}, {x, yo, radius});
      arch.faces.pop_back();  // drops the one of the two triangles that has no area
    }
    car.add(arch, kArch);
    Mesh tyre;
    add_disc(tyre, 0.006 - 0.2, radius, 0.2, 22);
    car.add(tyre, kTyre);
    Mesh rim;
    const double hub = radius * 0.66;
    if (alloy) {
      const auto on = [&](double angle, double rr) {
        return Vec3d(x + rr * std::cos(angle), side * (y + 0.009), radius + rr * std::sin(angle));
      };
      for (int s = 0; s < 5; ++s) {
        const double a = 2 * kPi * s / 5 + 0.3, w = 0.26;
        add_quad(rim, on(a - 0.6, 0.2 * hub), on(a - w, hub), on(a + w, hub), on(a + 0.6, 0.2 * hub));
      }
      for (int s = 0; s < 20; ++s) {
        const double a = 2 * kPi * s / 20, b = 2 * kPi * (s + 1) / 20;
        add_quad(rim, on(a, 0.9 * hub), on(a, 1.05 * hub), on(b, 1.05 * hub), on(b, 0.9 * hub));
      }
      add_disc(rim, 0.0, 0.22 * hub, 0.01, 10);
    } else {
      add_disc(rim, -0.003, hub, 0.012, 20);
    }
    car.add(rim, plain(Vec3f::Constant(alloy ? 0.42f : 0.22f), 0.45f, 0.1f));
  }
}

void add_patch(Actor& car, const Hull& hull, int axis, int side, Vec2d low, Vec2d high, double lift,
               const Material& material, int columns = 4, int rows = 3) {
  Mesh mesh = patch(hull.all, axis, side, low, high, lift, columns, rows);
  if (!mesh.faces.empty()) car.add(std::move(mesh), material);
}

/// On the front (`end` 1) or the rear (−1), to the left (`side` 1) or the right of the middle: from
/// `across.x` to `across.y` m off it, and between two heights.
void add_side_patch(Actor& car, const Hull& hull, int end, int side, const Vec2d& across,
                    const Vec2d& heights, double lift, const Material& material, int columns = 4,
                    int rows = 3) {
  const double a = side * across.x(), b = side * across.y();
  add_patch(car, hull, 0, end, {std::min(a, b), heights.x()}, {std::max(a, b), heights.y()}, lift, material,
            columns, rows);
}

// A number plate: the white board, a blue band at its left edge, and seven dark characters with a gap.
// `side`: +1 on the front, −1 on the rear.
void add_plate(Actor& car, const Hull& hull, int side, double z, double half_height, bool american) {
  const double half_width = american ? 0.155 : 0.26;
  if (american) half_height = 0.078;
  Mesh board =
      patch(hull.all, 0, side, {-half_width, z - half_height}, {half_width, z + half_height}, 0.012, 1, 1);
  if (board.faces.empty()) return;
  // add_quad's corners: low right, low left, high left, high right of +y.
  const Vec3d lift(0.003 * side, 0, 0), a = board.vertices[0] + lift, b = board.vertices[1] + lift,
                                        c = board.vertices[2] + lift, d = board.vertices[3] + lift;
  const auto on = [&](double s, double t) -> Vec3d {
    const double along = side < 0 ? s : 1 - s;  // as read from outside, left to right… the band comes first
    return (1 - t) * ((1 - along) * b + along * a) + t * ((1 - along) * c + along * d);
  };
  Mesh band, letters;
  add_quad(band, on(0, 0), on(0.085, 0), on(0.085, 1), on(0, 1));
  for (int i = 0; i < 8; ++i) {
    if (i == 3) continue;
    const double s = 0.13 + 0.105 * i;
    add_quad(letters, on(s, 0.2), on(s + 0.065, 0.2), on(s + 0.065, 0.8), on(s, 0.8));
  }
  car.add(std::move(board), kPlate);
  if (!american) car.add(band, kPlateBand);
  car.add(letters, plain(Vec3f::Constant(0.02f), 0.3f));
}

void add_front(Actor& car, const Hull& hull, const BodyShape& s, const CarTrim& extras,
               RandomStream& random) {
  const double w = 0.5 * s.width, h = s.height;
  const double inner = w * random.uniform(0.42, 0.58), low = h * (s.nose - random.uniform(0.13, 0.17));
  const double high = h * (s.nose - 0.015), outer = w * 0.90;
  Material lamp =
      plain(Vec3f(0.30f, 0.31f, 0.33f) * static_cast<float>(random.uniform(0.6, 1.3)), 0.4f, 0.12f);
  if (random.uniform() < 0.12) lamp.emission = Vec3f::Constant(2.5f);
  for (int side : {1, -1}) add_side_patch(car, hull, 1, side, {inner, outer}, {low, high}, 0.008, lamp);
  Material grille = plain(Vec3f::Constant(0.02f), 0.1f, 0.02f);
  grille.pattern = Pattern::grille;
  const double g = inner * random.uniform(0.5, 0.95);
  add_patch(car, hull, 0, 1, {-g, low + 0.02}, {g, high - 0.01}, 0.006, grille);
  const double intake = w * random.uniform(0.45, 0.75), z = h * (s.clearance + 0.07);
  add_patch(car, hull, 0, 1, {-intake, z}, {intake, z + h * random.uniform(0.05, 0.11)}, 0.006, grille);
  const double plate = h * (s.nose - random.uniform(0.19, 0.22));
  add_plate(car, hull, 1, plate, 0.055, extras.american);
  // Inside each lamp a dark reflector's edge and an amber indicator at the outer end.
  for (int side : {1, -1}) {
    const double a = inner + 0.30 * (outer - inner), b = inner + 0.38 * (outer - inner);
    const double c = inner + 0.92 * (outer - inner);
    add_side_patch(car, hull, 1, side, {a, b}, {low, high}, 0.011, kTrim, 1, 2);
    add_side_patch(car, hull, 1, side, {c, outer}, {low, high}, 0.011, kAmber, 1, 2);
  }
}

void add_rear(Actor& car, const Hull& hull, const BodyShape& s, const CarTrim& extras, RandomStream& random) {
  const double w = 0.5 * s.width, h = s.height;
  Material lamp = plain(Vec3f(0.42f, 0.012f, 0.012f), 1.2f, 0.06f);
  if (random.uniform() < 0.15) lamp.emission = Vec3f(1.6f, 0.06f, 0.04f);
  const bool upright = random.uniform() < 0.45;
  const double top = h * (s.tail - 0.03), low = top - h * (upright ? 0.22 : random.uniform(0.09, 0.13));
  const double inner = w * (upright ? 0.74 : random.uniform(0.5, 0.62)), outer = 0.92 * w;
  for (int side : {1, -1}) add_side_patch(car, hull, -1, side, {inner, outer}, {low, top}, 0.008, lamp);
  const bool high_plate = random.uniform() < 0.6;
  const double plate = high_plate ? h * (s.tail - random.uniform(0.13, 0.17)) : h * (s.clearance + 0.17);
  add_plate(car, hull, -1, plate, 0.06, extras.american);
  // Indicator and reversing lamp: two bands of the rear lamp.
  for (int side : {1, -1}) {
    const double cut = std::lerp(low, top, 0.36), middle = std::lerp(low, top, 0.58);
    if (upright || extras.split_lamps)
      add_side_patch(car, hull, -1, side, {inner, outer}, {cut, middle}, 0.011,
                     upright && !extras.american ? kAmber : kClear, 2, 1);
    else
      add_side_patch(car, hull, -1, side, {inner, inner + 0.3 * (outer - inner)}, {low, middle}, 0.011,
                     kClear, 2, 1);
  }
  add_patch(car, hull, 0, -1, {-0.34, plate + 0.07}, {0.34, plate + 0.10}, 0.01, kTrim, 2, 1);
  const double z = h * (s.clearance + 0.065);
  add_patch(car, hull, 0, -1, {-0.78 * w, z}, {0.78 * w, z + 0.06 * h}, 0.006, kTrim);
}

void add_sides(Actor& car, const Hull& hull, const BodyShape& s, RandomStream& random) {
  const double h = s.height;
  const double b_post = std::lerp(s.roof_front_u, s.roof_rear_u, 0.34);
  const bool strip = random.uniform() < 0.4;
  for (int side : {1, -1}) {
    for (double u : {b_post + 0.07, std::min(b_post + 0.27, s.rear_axle_u + 0.01)})
      add_patch(car, hull, 1, side, {s.x_at(u) - 0.09, h * s.belt_front - 0.11},
                {s.x_at(u) + 0.09, h * s.belt_front - 0.075}, 0.02,
                random.uniform() < 0.5 ? kTrim : plain(Vec3f::Constant(0.3f), 0.3f, 0.05f), 1, 1);
    // Shut lines of the doors.
    for (double u : {s.cowl_u + 0.05, b_post, std::min(b_post + 0.21, s.rear_axle_u - 0.03)})
      add_patch(car, hull, 1, side, {s.x_at(u) - 0.005, h * (s.clearance + 0.06)},
                {s.x_at(u) + 0.005, h * s.belt_front - 0.02}, 0.003, kArch, 1, 5);
    if (strip)
      add_patch(car, hull, 1, side, {s.x_at(s.rear_axle_u - 0.09), h * 0.33},
                {s.x_at(s.front_axle_u + 0.09), h * 0.36}, 0.012, kTrim, 8, 1);
  }
}

// Roof rails, wipers, an aerial, a pick-up's bed.
void add_top(Actor& car, const Hull& hull, const BodyShape& s, const CarTrim& extras) {
  const auto top = [&](double x, double y) { return top_at(hull.all, x, y); };
  if (extras.rails) {
    Mesh rails;
    const double y = 0.5 * s.width * (1 - s.tumblehome) * 0.88;
    const double a = s.roof_front_u + 0.06, b = s.roof_rear_u - 0.01;
    for (int side : {1, -1})
      for (int i = 0; i < 6; ++i) {
        const double x0 = s.x_at(std::lerp(a, b, i / 6.0)), x1 = s.x_at(std::lerp(a, b, (i + 1) / 6.0));
        const double z = std::min(0.5 * (top(x0, side * y) + top(x1, side * y)), s.height - 0.02);
        add_box(rails, {x1, side * y - 0.018, i % 5 == 0 ? z - 0.03 : z - 0.01},
                {x0, side * y + 0.018, z + 0.018});
      }
    car.add(rails, extras.bright_rails ? plain(Vec3f::Constant(0.4f), 0.5f, 0.1f) : kTrim);
  }
  Mesh wipers;
  const double u = s.cowl_u + 0.02, v = std::lerp(s.cowl_u, s.roof_front_u, 0.55), w = 0.5 * s.width;
  for (double y : {-0.62 * w, -0.02 * w}) {
    const double x0 = s.x_at(u), x1 = s.x_at(v), z0 = top(x0, y) + 0.012, z1 = top(x1, y + 0.5 * w) + 0.012;
    add_quad(wipers, {x0, y - 0.012, z0}, {x0, y + 0.012, z0},
             {std::lerp(x0, x1, 0.5), y + 0.5 * w + 0.012, std::lerp(z0, z1, 0.5) + 0.01},
             {std::lerp(x0, x1, 0.5), y + 0.5 * w - 0.012, std::lerp(z0, z1, 0.5) + 0.01});
  }
  car.add(wipers, kTrim);
  if (extras.bed) {  // seen from above and behind: the bed's dark cover between its walls
    Mesh cover;
    const double front = s.window_foot_u + 0.02;
    for (int i = 0; i < 6; ++i) {
      const double x0 = s.x_at(std::lerp(front, 0.97, i / 6.0)),
                   x1 = s.x_at(std::lerp(front, 0.97, (i + 1) / 6.0)), y = 0.36 * s.width;
      const double z0 = top(x0, 0) + 0.006, z1 = top(x1, 0) + 0.006;
      add_quad(cover, {x1, -y, z1}, {x0, -y, z0}, {x0, y, z0}, {x1, y, z1});
    }
    car.add(cover, kTrim);
  }
}

void add_seats(Actor& car, const BodyShape& s) {
  Mesh seats;
  const double w = 0.5 * s.width, h = s.height;
  const double front = s.x_at(std::lerp(s.roof_front_u, s.roof_rear_u, 0.30)),
               rear = s.x_at(std::lerp(s.roof_front_u, s.roof_rear_u, 0.80));
  for (int side : {1, -1}) {
    const double y = side * 0.42 * w;
    add_box(seats, {front - 0.12, y - 0.24, 0.3 * h}, {front + 0.08, y + 0.24, 0.70 * h});
    add_box(seats, {front - 0.10, y - 0.13, 0.70 * h}, {front, y + 0.13, 0.84 * h});
    add_box(seats, {rear - 0.05, y - 0.13, 0.66 * h}, {rear + 0.05, y + 0.13, 0.78 * h});
  }
  add_box(seats, {rear - 0.10, -0.75 * w, 0.3 * h}, {rear + 0.10, 0.75 * w, 0.67 * h});
  add_box(seats, {rear, -0.8 * w, 0.22 * h}, {s.x_at(s.cowl_u + 0.02), 0.8 * w, 0.34 * h});
  add_box(seats, {s.x_at(s.cowl_u + 0.12), -0.75 * w, 0.34 * h},
          {s.x_at(s.cowl_u + 0.03), 0.75 * w, 0.63 * h});  // dashboard
  car.add(seats, plain(Vec3f::Constant(0.03f), 0.15f));
}

// Loads that people carry on the roofs of their cars.

/// The roof that a load lies on, in the car's frame (m).
struct Roof {
  double middle = 0, length = 1, half_width = 0.6;
  double top = 1.5;  ///< of the label box
};

Material thing(RandomStream& random, const Vec3f& albedo) {
  return plain(albedo, static_cast<float>(random.uniform(0.05, 0.4)));
}

Material grey(RandomStream& random, double low, double high) {
  return thing(random, Vec3f::Constant(static_cast<float>(random.uniform(low, high))));
}

void add_taxi_sign(Actor& car, const Roof& roof, RandomStream& random) {
  Mesh sign, letters;
  const double x = roof.middle + 0.2 * roof.length, w = random.uniform(0.2, 0.4),
               h = random.uniform(0.12, 0.2);
  add_box(sign, {x - 0.07, -w, roof.top - 0.05}, {x + 0.07, w, roof.top + h});
  for (double side : {-1.0, 1.0})
    add_box(letters, {x + side * 0.072 - 0.001, -0.7 * w, roof.top + 0.3 * h},
            {x + side * 0.072 + 0.001, 0.7 * w, roof.top + 0.75 * h});
  Material yellow = thing(random, Vec3f(0.7f, 0.5f, 0.05f));
  if (random.uniform() < 0.4) yellow.emission = Vec3f(0.7f, 0.5f, 0.1f);
  car.add(std::move(sign), yellow);
  car.add(std::move(letters), grey(random, 0.01, 0.05));
}

/// Two bars across on feet; the load lies on them at the returned height.
double add_bars(Actor& car, const Roof& roof, RandomStream& random) {
  const Mesh body = car.surfaces.front().mesh;
  Mesh bars;
  const double deck = roof.top + 0.07;
  for (double share : {-0.28, 0.28}) {
    const double x = roof.middle + share * roof.length, y = 0.9 * roof.half_width;
    add_box(bars, {x - 0.03, -roof.half_width, deck - 0.035}, {x + 0.03, roof.half_width, deck});
    for (double foot : {-y, y}) {
      const double z = std::clamp(top_at(body, x, foot), roof.top - 0.25, roof.top);
      add_box(bars, {x - 0.04, foot - 0.03, z - 0.02}, {x + 0.04, foot + 0.03, deck - 0.02});
    }
  }
  car.add(std::move(bars), grey(random, 0.02, 0.35));
  return deck;
}

void add_box_on_roof(Actor& car, const Roof& roof, double deck, RandomStream& random) {
  const double l = std::min(random.uniform(1.3, 2.1), 1.3 * roof.length), w = random.uniform(0.28, 0.45),
               h = random.uniform(0.28, 0.42), x = roof.middle + random.uniform(-0.1, 0.15);
  // A superellipsoid's upper part: round ends, nearly flat sides.
  Mesh shell = ellipsoid({1, 1, 1}, 3);
  for (Vec3d& v : shell.vertices) {
    const Vec3d p(std::copysign(std::pow(std::abs(v.x()), 0.45), v.x()),
                  std::copysign(std::pow(std::abs(v.y()), 0.45), v.y()),
                  std::copysign(std::pow(std::abs(v.z()), 0.5), v.z()));
    v = Vec3d(x + 0.5 * l * p.x(), w * p.y() * (1 - 0.12 * (p.z() + 1)), deck + 0.5 * h * (p.z() + 1));
  }
  Material skin = paint_of(random);
  const double pick = random.uniform();
  if (pick < 0.75) skin.albedo = Vec3f::Constant(pick < 0.4 ? 0.02f : pick < 0.6 ? 0.2f : 0.65f);
  car.add(std::move(shell), skin, true);
}

void add_ladder(Actor& car, const Roof& roof, double deck, RandomStream& random) {
  Mesh ladder;
  const double l = std::min(random.uniform(2, 3.2), 2.2 * roof.length),
               x0 = roof.middle - random.uniform(0.45, 0.6) * l;
  const double y = random.uniform(-0.2, 0.2) * roof.half_width, w = random.uniform(0.17, 0.22);
  const int layers = 1 + random.below(2);
  for (int k = 0; k < layers; ++k) {
    const double z = deck + 0.08 * k;
    for (double side : {-w, w})
      add_box(ladder, {x0, y + side - 0.02, z}, {x0 + l, y + side + 0.02, z + 0.07});
    for (double x = x0 + 0.15; x < x0 + l; x += 0.28)
      add_box(ladder, {x - 0.015, y - w, z + 0.02}, {x + 0.015, y + w, z + 0.05});
  }
  car.add(std::move(ladder),
          random.uniform() < 0.6 ? grey(random, 0.3, 0.5) : thing(random, Vec3f(0.45f, 0.28f, 0.05f)));
}

void add_skis(Actor& car, const Roof& roof, double deck, RandomStream& random) {
  const int pairs = 2 + random.below(3);
  for (int k = 0; k < pairs; ++k) {
    Mesh pair;
    const double y = (k - 0.5 * (pairs - 1)) * 0.27, l = random.uniform(1.5, 1.9),
                 x0 = roof.middle - random.uniform(0.45, 0.55) * l;
    for (double side : {-0.06, 0.06}) {
      add_box(pair, {x0, y + side - 0.045, deck}, {x0 + l - 0.2, y + side + 0.045, deck + 0.035});
      add_quad(pair, {x0 + l - 0.2, y + side + 0.045, deck + 0.02},
               {x0 + l - 0.2, y + side - 0.045, deck + 0.02}, {x0 + l, y + side - 0.04, deck + 0.12},
               {x0 + l, y + side + 0.04, deck + 0.12});
      add_box(pair, {x0 + 0.4 * l, y + side - 0.035, deck + 0.035},
              {x0 + 0.55 * l, y + side + 0.035, deck + 0.09});
    }
    car.add(std::move(pair), thing(random, 1.3f * random_cloth(random)));
  }
}

void add_carpets(Actor& car, const Roof& roof, double deck, RandomStream& random) {
  const int rolls = 1 + random.below(3);
  double y = -0.16 * (rolls - 1);
  for (int k = 0; k < rolls; ++k) {
    const double r = random.uniform(0.1, 0.17), l = random.uniform(1.6, 2.6);
    Mesh roll;
    append(roll, cylinder(r, l, 14),
           Transform(Eigen::Translation3d(roof.middle - 0.5 * l, y, deck + r) *
                     Eigen::AngleAxisd(0.5 * kPi, Vec3d::UnitY())));
    Material cloth = thing(random, random_cloth(random));
    cloth.pattern = Pattern::cloth, cloth.variant = random.next_u32();
    car.add(std::move(roll), cloth);
    y += 0.33;
  }
}

void add_timber(Actor& car, const Roof& roof, double deck, RandomStream& random) {
  Mesh boards;
  const int wide = 2 + random.below(4), high = 1 + random.below(3);
  for (int k = 0; k < high; ++k)
    for (int i = 0; i < wide; ++i) {
      const double l = random.uniform(1.9, 3.2), x0 = roof.middle - random.uniform(0.45, 0.58) * l,
                   y = 0.17 * (i - 0.5 * (wide - 1));
      add_box(boards, {x0, y - 0.08, deck + 0.055 * k}, {x0 + l, y + 0.08, deck + 0.055 * k + 0.05});
    }
  Material wood = thing(random, Vec3f(0.42f, 0.29f, 0.16f) * static_cast<float>(random.uniform(0.5, 1.3)));
  car.add(std::move(boards), wood);
}

}  // namespace

Material paint_of(RandomStream& random) {
  double sum = 0;
  for (const Paint& p : kPaints) sum += p.share;
  const Paint& paint = by_share(kPaints, sum * random.uniform());
  const float scatter = static_cast<float>(std::exp(random.uniform(-1.2, 1.2))),
              tone = static_cast<float>(random.uniform(0.8, 1.15));
  Material m = plain(tone * paint.color, 0.24f * paint.lidar * scatter, 0.045f);
  if (random.uniform() < 0.25) m.gloss = 0.02f;  // dusty
  return m;
}

Actor assemble(const BodyShape& s, const std::string& type, const CarTrim& extras, RandomStream& random) {
  Actor car;
  car.type = type;
  const Hull hull = loft(s);
  const Material paint = paint_of(random);
  car.add(hull.paint, paint, true);
  car.add(hull.glass, window(random), true);
  car.add(hull.trim, kTrim, true);
  const bool alloy = random.uniform() < 0.6;
  for (const double u : {s.front_axle_u, s.rear_axle_u})
    add_axle(car, hull, s.x_at(u), s.wheel_radius, alloy);
  add_front(car, hull, s, extras, random);
  add_rear(car, hull, s, extras, random);
  add_sides(car, hull, s, random);
  add_seats(car, s);
  add_top(car, hull, s, extras);
  fit_label_box(car);
  Mesh mirrors;
  for (int side : {1, -1}) {
    const double x = s.x_at(s.cowl_u + 0.06), y = side * 0.50 * s.width;
    const double z = s.height * (s.belt_front + 0.05);
    append(mirrors, ellipsoid({0.07, 0.10, 0.075}), at(x, y + side * 0.06, z));
  }
  car.add(mirrors, random.uniform() < 0.5 ? kTrim : paint);
  stretch(car, {s.length, s.width, s.height});
  return car;
}

void add_roof_load(Actor& car, const BodyShape& s, RandomStream& random) {
  if (random.uniform() >= 0.1) return;
  const double front = car.size.x() * (0.5 - s.roof_front_u), rear = car.size.x() * (0.5 - s.roof_rear_u);
  const Roof roof{0.5 * (front + rear), front - rear, 0.42 * car.size.y() * (1 - s.tumblehome), car.size.z()};
  const int pick = random.below(6);
  if (pick == 0) {
    add_taxi_sign(car, roof, random);
    return;
  }
  const double deck = add_bars(car, roof, random);
  if (pick == 1) add_box_on_roof(car, roof, deck, random);
  if (pick == 2) add_ladder(car, roof, deck, random);
  if (pick == 3) add_skis(car, roof, deck, random);
  if (pick == 4) add_carpets(car, roof, deck, random);
  if (pick == 5) add_timber(car, roof, deck, random);
}

}  // namespace mirage::generator
