// What people carry on the roofs of their cars.
#include <algorithm>
#include <cmath>
#include <numbers>

#include "generator/car_assembly.h"
#include "geometry/shapes.h"

namespace mirage::generator {
namespace {

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

void lay(Actor& car, Mesh mesh, const Material& material) {
  car.surfaces.push_back(surface(std::move(mesh), material));
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
  lay(car, std::move(sign), yellow);
  lay(car, std::move(letters), grey(random, 0.01, 0.05));
}

/// Two bars across on feet; what is carried lies on them at the returned height.
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
  lay(car, std::move(bars), grey(random, 0.02, 0.35));
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
  car.surfaces.push_back(surface(std::move(shell), skin, true));
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
  lay(car, std::move(ladder),
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
    lay(car, std::move(pair), thing(random, 1.3f * random_cloth(random)));
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
                     Eigen::AngleAxisd(0.5 * std::numbers::pi, Vec3d::UnitY())));
    Material cloth = thing(random, random_cloth(random));
    cloth.pattern = Pattern::cloth, cloth.variant = random.next_u32();
    car.surfaces.push_back(surface(std::move(roll), cloth));
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
  lay(car, std::move(boards), wood);
}

}  // namespace

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
