// The detector's input where a renderer without derivatives draws the object: the control variate, when
// pictures are rendered anew, and that a stopped attack resumes to the same bits.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <mutex>
#include <set>

#include "attack/attack.h"
#include "attack/attack_step.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/random.h"
#include "simulation/render_scene.h"
#include "support/files.h"
#include "support/gradient_check.h"
#include "support/random_vector.h"

namespace mirage {
namespace {

using test::error_text;
using testing::HasSubstr;

/// A picture that depends on mesh and seed, in a window larger than the object's.
class KnownRenderer : public ObjectRenderer {
 public:
  Window draw(const HostInWorld& host, const TexturedMesh& adversary, const Simulated& simulated,
              std::uint64_t seed) override {
    if (++calls == fails_at) throw Failure("known renderer", "lost", "run again");
    {
      const std::lock_guard lock(mutex);
      seeds.insert(seed);
    }
    const ImageF& photograph = host.prepared.frame.image;
    const PixelRect& r = simulated.rect;
    Window window{{std::max(0, r.u0 - 3), std::max(0, r.v0 - 2), std::min(photograph.width, r.u1 + 3),
                   std::min(photograph.height, r.v1 + 2)},
                  {}};
    window.picture = crop(photograph, window.rect);
    RandomStream random(seed, "known renderer");
    const double level = 0.3 * adversary.atlas.texels[0].x() + adversary.mesh.vertices[0].norm() - 0.5;
    for (float& value : window.picture.data) value += static_cast<float>(level + 0.4 * random.uniform());
    return window;
  }
  nlohmann::json identity() const override { return {{"name", "known"}, {"samples", samples}}; }

  std::atomic<int> calls = 0;  // hosts of a step are drawn in parallel
  int fails_at = -1, samples = 1;
  std::set<std::uint64_t> seeds;
  std::mutex mutex;  // of `seeds`
};

/// The tiny world's first host.
struct OneHost {
  explicit OneHost(const test::TemporaryFolder& folder) : data(folder / "data") {
    test::write_tiny_data(data, 1);
    store = std::make_unique<FrameStore>(FrameSource{data, "ip-basic", "box"});
    prepared = store->get("000000");
    host = find_hosts(*store, "000000", {0, 50, -25, 25}, {}).at(0).id;
    placement = store->placement(host);
    RandomStream random(4, "rendered pictures");
    mesh = initial_adversary();
    for (Vec3d& v : mesh.mesh.vertices) v *= random.uniform(0.9, 1.1);
    for (Vec3d& t : mesh.atlas.texels) t = test::random_vector(random, 0, 1);
  }
  Simulated simulated(const TexturedMesh& of, const SimulationSettings& settings = {}) const {
    return simulate(*prepared, placement, of, settings);
  }
  HostInWorld in_world(const SimulationSettings& settings) const {
    return {*prepared, host, placement, settings};
  }
  std::filesystem::path data;
  std::unique_ptr<FrameStore> store;
  std::shared_ptr<const PreparedFrame> prepared;
  HostId host;
  Placement placement;
  TexturedMesh mesh;
};

double shown_to_be(double value) {
  return std::clamp(value, 0.0, 1.0);
}

TEST(RenderedPictures, OfTheMeshItselfTheDetectorSeesTheRenderersPicture) {
  const test::TemporaryFolder folder;
  const OneHost world(folder);
  KnownRenderer renderer;
  RenderedPictures pictures(renderer, 7);
  const SimulationSettings settings;
  Simulated simulated = world.simulated(world.mesh);
  const Simulated plain = simulated;
  const PixelRect rect = pictures.correct(world.in_world(settings), world.mesh, {0, world.mesh}, simulated);
  ASSERT_EQ(renderer.calls, 1);
  const ObjectRenderer::Window known =
      renderer.draw(world.in_world(settings), world.mesh, plain, *renderer.seeds.begin());
  ASSERT_EQ(rect.u0, known.rect.u0);
  ASSERT_EQ(rect.v1, known.rect.v1);
  ASSERT_LT(rect.u0, plain.rect.u0);  // it reaches beyond the rasteriser's window
  int over = 0;
  for (int v = 0; v < simulated.image.height; ++v)
    for (int u = 0; u < simulated.image.width; ++u)
      for (int c = 0; c < 3; ++c) {
        const bool inside = u >= rect.u0 && u < rect.u1 && v >= rect.v0 && v < rect.v1;
        const double wanted =
            inside ? known.picture.at(u - rect.u0, v - rect.v0, c) : world.prepared->frame.image.at(u, v, c);
        over += wanted > 1;
        ASSERT_NEAR(simulated.image.at(u, v, c), shown_to_be(wanted), 1e-6);
      }
  EXPECT_GT(over, 0);  // some pixels saturate
}

TEST(RenderedPictures, BetweenTwoDrawsThePictureFollowsTheMesh) {
  const test::TemporaryFolder folder;
  const OneHost world(folder);
  KnownRenderer renderer;
  RenderedPictures pictures(renderer, 7);
  const SimulationSettings settings;
  TexturedMesh moved = world.mesh;
  for (Vec3d& v : moved.mesh.vertices) v *= 1.04;
  for (Vec3d& t : moved.atlas.texels) t *= 0.9;
  const Simulated now = world.simulated(moved), then = world.simulated(world.mesh);
  Simulated simulated = now;
  const RenderedMesh rendered{3, world.mesh};
  const PixelRect rect = pictures.correct(world.in_world(settings), moved, rendered, simulated);
  const ObjectRenderer::Window known =
      renderer.draw(world.in_world(settings), world.mesh, then, *renderer.seeds.begin());
  const auto raster = [&](const Simulated& of, int u, int v, int c) {  // before clipping
    const PixelRect& r = of.rect;
    return u >= r.u0 && u < r.u1 && v >= r.v0 && v < r.v1 ? of.rgba.at(u - r.u0, v - r.v0, c)
                                                          : world.prepared->frame.image.at(u, v, c);
  };
  double change = 0;
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u)
      for (int c = 0; c < 3; ++c) {
        const double drawn = known.picture.at(u - rect.u0, v - rect.v0, c);
        const double wanted = raster(now, u, v, c) + (drawn - raster(then, u, v, c));
        ASSERT_NEAR(simulated.image.at(u, v, c), shown_to_be(wanted), 1e-6) << u << " " << v;
        change += std::abs(wanted - drawn);
      }
  EXPECT_GT(change, 1);

  // For the same mesh it is not drawn again; in another iteration, with other random numbers, it is.
  EXPECT_EQ(renderer.calls, 2);
  Simulated again = now;
  pictures.correct(world.in_world(settings), moved, rendered, again);
  EXPECT_EQ(renderer.calls, 2);
  EXPECT_EQ(again.image.data, simulated.image.data);
  pictures.correct(world.in_world(settings), moved, {4, world.mesh}, again);
  EXPECT_EQ(renderer.calls, 3);
  EXPECT_EQ(renderer.seeds.size(), 2u);
  HostInWorld other = world.in_world(settings);
  other.world = 9;  // and in another world
  pictures.correct(other, moved, {4, world.mesh}, again);
  EXPECT_EQ(renderer.calls, 4);
}

TEST(RenderedPictures, TheVjpIsTheDerivativeOfWhatIsShown) {
  const test::TemporaryFolder folder;
  const OneHost world(folder);
  KnownRenderer renderer;
  SimulationSettings settings;
  settings.reference = true;  // in double
  settings.raster.sigma = 1e-5;
  settings.supersampling = 1;
  const RenderedMesh rendered{0, world.mesh};
  RandomStream random(5, "rendered pictures");
  ImageF weights(248, 75, 3);
  for (float& w : weights.data) w = static_cast<float>(random.uniform(-1, 1));
  RenderedPictures pictures(renderer, 7);
  int saturated = 0;
  const auto shown = [&](const TexturedMesh& mesh) {
    Simulated simulated = world.simulated(mesh, settings);
    pictures.correct(world.in_world(settings), mesh, rendered, simulated);
    return simulated;
  };
  const auto loss = [&](const TexturedMesh& mesh) {
    const Simulated simulated = shown(mesh);
    double sum = 0;
    saturated = 0;
    for (int v = simulated.rect.v0; v < simulated.rect.v1; ++v)
      for (int u = simulated.rect.u0; u < simulated.rect.u1; ++u)
        for (int c = 0; c < 3; ++c) {
          const double value = rgba_at(simulated, u, v, c);
          saturated += value > 1;
          sum += weights.at(u, v, c) * shown_to_be(value);
        }
    return sum;
  };
  TexturedMesh moved = world.mesh;
  for (Vec3d& v : moved.mesh.vertices)
    for (double& c : v) c += 5e-3 * random.normal();
  const AdversaryGradient gradient = simulate_vjp(shown(moved), weights, {});
  std::vector<double> vertices, analytic;
  for (std::size_t i = 0; i < moved.mesh.vertices.size(); ++i)
    for (int c = 0; c < 3; ++c) {
      vertices.push_back(moved.mesh.vertices[i][c]);
      analytic.push_back(gradient.vertices[i][c]);
    }
  const auto of_vertices = [&](const std::vector<double>& values) {
    TexturedMesh mesh = moved;
    for (std::size_t i = 0; i < values.size(); ++i)
      mesh.mesh.vertices[i / 3][static_cast<int>(i % 3)] = values[i];
    return loss(mesh);
  };
  test::check_gradient(of_vertices, vertices, analytic, 1e-6, 1e-4, 1e-1,
                       [](std::size_t i) { return i % 61 == 0; });
  const int all = 3 * shown(moved).rect.width() * shown(moved).rect.height();
  EXPECT_GT(saturated, all / 20);  // both saturated and unsaturated pixels are checked
  EXPECT_LT(saturated, all * 19 / 20);
  EXPECT_EQ(renderer.calls, 1);
}

TEST(RenderedPictures, AMeshHasMovedBeyondTheRootMeanSquare) {
  const TexturedMesh from = initial_adversary();
  TexturedMesh to = from;
  const RedrawThresholds redraw{0.01, 0.05};
  EXPECT_FALSE(has_moved(from, to, redraw));
  EXPECT_FALSE(has_moved(from, to, {0, 0}));
  for (Vec3d& v : to.mesh.vertices) v += Vec3d(0.006, 0.006, 0.005);  // 9.85 mm
  EXPECT_FALSE(has_moved(from, to, redraw));
  EXPECT_TRUE(has_moved(from, to, {0, 1}));
  for (Vec3d& v : to.mesh.vertices) v.z() += 0.001;  // 11 mm
  EXPECT_TRUE(has_moved(from, to, redraw));
  to.mesh = from.mesh;
  for (Vec3d& t : to.atlas.texels) t += Vec3d::Constant(0.049);
  EXPECT_FALSE(has_moved(from, to, redraw));
  for (Vec3d& t : to.atlas.texels) t.x() += 0.005;
  EXPECT_TRUE(has_moved(from, to, redraw));
}

/// An attack with its own renderer.
struct RenderedAttack {
  RenderedAttack(const test::TemporaryFolder& folder, const char* out, int iterations) {
    settings.data = folder / "data";
    settings.out = folder / out;
    settings.iterations = iterations;
    settings.checkpoint.steps = 100;
    settings.vertex_rate = 5e-3;
    settings.rooftop = "box";
    settings.quiet = true;
    settings.renderer = renderer;
    settings.redraw = {0.012, 0.05};  // two or three steps
    for (int i = 0; i < 2; ++i) detectors.push_back(std::make_unique<test::StandInDetector>());
  }
  AttackResult run() { return run_attack(settings, detectors); }
  std::shared_ptr<KnownRenderer> renderer = std::make_shared<KnownRenderer>();
  AttackSettings settings = test::tiny_attack();
  DetectorPool detectors;
};

nlohmann::json checkpoint_of(const test::TemporaryFolder& folder, const char* out) {
  return read_json(folder / out / "checkpoint.json");
}

TEST(RenderedPictures, AreRenewedWhereTheMeshHasMovedAndTheDetectorLooksAtThem) {
  const test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 4);
  RenderedAttack always(folder, "always", 6), never(folder, "never", 6), now_and_then(folder, "some", 6),
      raster(folder, "raster", 6);
  always.settings.redraw = {0, 0};
  never.settings.redraw = {10, 10};
  raster.settings.renderer = nullptr;
  const int vehicles = always.run().vehicles_train;
  ASSERT_GE(vehicles, 2);
  EXPECT_EQ(always.renderer->calls, 6 * always.settings.batch);
  never.run();
  EXPECT_EQ(never.renderer->calls, vehicles);  // each host once
  now_and_then.run();
  EXPECT_GT(now_and_then.renderer->calls, vehicles);
  EXPECT_LT(now_and_then.renderer->calls, 6 * always.settings.batch);
  raster.run();
  const auto losses = [&](const char* out) { return checkpoint_of(folder, out).at("losses"); };
  EXPECT_NE(losses("raster")[0], losses("never")[0]);  // other pictures
  EXPECT_EQ(losses("always")[0], losses("never")[0]);  // the same pictures
  EXPECT_NE(losses("always"), losses("never"));
}

TEST(RenderedPictures, AStoppedAttackGoesOnToTheSameBits) {
  const test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 8);
  for (const int until_plateau : {0, 100}) {
    SCOPED_TRACE(until_plateau);
    const std::string name = std::to_string(until_plateau), whole = "whole" + name, parts = "parts" + name;
    const auto attack = [&](const std::string& out, int iterations) {
      RenderedAttack some(folder, out.c_str(), iterations);
      some.settings.until_plateau = until_plateau;
      some.settings.validation_every = 2;
      some.run();
    };
    attack(whole, 8);
    bool between = false;  // a stop at a step that uses pictures of an earlier mesh
    for (int iterations = 1; iterations <= 8; ++iterations) {
      attack(parts, iterations);
      const auto state = checkpoint_of(folder, parts.c_str());
      const long drawn = state.at("rendered").at("iteration");
      between = between || (drawn > 0 && drawn < iterations - 1);
    }
    EXPECT_TRUE(between);
    for (const char* file : {"adversary.glb", "loss.csv", "checkpoint.json"})
      EXPECT_EQ(read_file(folder / whole / file), read_file(folder / parts / file)) << file;
  }
}

TEST(RenderedPictures, ALostRendererCostsNoStep) {
  const test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 4);
  RenderedAttack whole(folder, "whole", 7), lost(folder, "lost", 7), after(folder, "lost", 7);
  whole.settings.redraw = lost.settings.redraw = after.settings.redraw = {0, 0};
  whole.run();
  lost.renderer->fails_at = 2 * 4 + 1;  // in the fifth step
  EXPECT_THAT(error_text<Failure>([&] { lost.run(); }), HasSubstr("known renderer"));
  EXPECT_EQ(checkpoint_of(folder, "lost").at("iteration"), 4);
  after.run();
  EXPECT_EQ(after.renderer->calls, 2 * 3);
  EXPECT_EQ(read_file(folder / "whole/adversary.glb"), read_file(folder / "lost/adversary.glb"));
}

TEST(RenderedPictures, ARunNamesItsRenderer) {
  const test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3);
  RenderedAttack attack(folder, "run", 1);
  attack.run();
  const nlohmann::json run = read_json(folder / "run/run.json");
  EXPECT_EQ(run.at("renderer"), attack.renderer->identity());
  EXPECT_EQ(run.at("renewal").at("metres"), attack.settings.redraw.metres);
  EXPECT_EQ(read_run(folder / "run").train.size(), run.at("train").size());  // other commands can read it
  attack.settings.iterations = 2;
  attack.renderer->samples = 2;
  EXPECT_THAT(error_text<InputError>([&] { attack.run(); }), HasSubstr("renderer"));
  attack.renderer->samples = 1;
  attack.settings.redraw.metres *= 2;
  EXPECT_THAT(error_text<InputError>([&] { attack.run(); }), HasSubstr("renewal"));
  attack.settings.renderer = nullptr;
  EXPECT_THAT(error_text<InputError>([&] { attack.run(); }), HasSubstr("renderer"));

  RenderedAttack plain(folder, "plain", 1);
  plain.settings.renderer = nullptr;
  plain.run();
  EXPECT_EQ(read_json(folder / "plain/run.json").at("renderer"), "raster");
}

/// Ignores the picture.
class BlindStandIn : public test::StandInDetector {
 public:
  Capabilities capabilities() const override { return {false, true, true, false}; }
};

TEST(RenderedPictures, ADetectorThatReadsNoPictureIsRefused) {
  const test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2);
  RenderedAttack attack(folder, "run", 1);
  attack.detectors.clear();
  attack.detectors.push_back(std::make_unique<BlindStandIn>());
  EXPECT_THAT(
      error_text<InputError>([&] { attack.run(); }),
      testing::AllOf(testing::StartsWith("renderer: cycles: "), HasSubstr("does not read the picture")));
}

}  // namespace
}  // namespace mirage
