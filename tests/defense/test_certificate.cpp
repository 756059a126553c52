// Masks that cover everything an object can change, and the certificates that rest on them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/random.h"
#include "defense/certificate.h"
#include "detection/detector_settings.h"
#include "generator/dataset.h"
#include "scene/data/read_frames.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using test::TemporaryFolder;

Box3 random_box(RandomStream& random) {
  Box3 box;
  box.bev = {random.uniform(3, 40), random.uniform(-10, 10), random.uniform(0.2, 2), random.uniform(0.2, 2),
             random.uniform(-3, 3)};
  box.bottom = random.uniform(-1, 1);
  box.height = random.uniform(0.1, 1.5);
  return box;
}

TEST(RoofMask, TakesEveryRayThatMeetsTheBoxAndFewOthers) {
  RandomStream random(3, "rays through boxes");
  int met = 0, near_miss = 0, taken = 0;
  for (int trial = 0; trial < 4000; ++trial) {
    const Box3 box = random_box(random);
    MaskMargin margin;
    margin.metres = 0.01;
    margin.beam_origin = 0.25;
    const Transform box_from_velo = velo_from_box(box).inverse();
    const Vec3d aim = velo_from_box(box) * Vec3d{random.uniform(-1.2, 1.2) * box.bev.length,
                                                 random.uniform(-1.2, 1.2) * box.bev.width,
                                                 random.uniform(-0.5, 1.5) * box.height};
    const Vec3d point = aim * random.uniform(0.9, 2);
    // The closest that any beam comes: beams from all around the unit, at many places on their way.
    double closest = 1e9;
    for (int beam = 0; beam < 12; ++beam) {
      Vec3d from{random.normal(), random.normal(), random.normal()};
      from *= margin.beam_origin / from.norm();
      for (int k = 0; k <= 200; ++k) {
        const Vec3d q = box_from_velo * (from + (point - from) * (k / 200.0));
        const Vec3d half(box.bev.length / 2, box.bev.width / 2, 0);
        const Vec3d inside =
            q.cwiseMax(Vec3d(-half.x(), -half.y(), 0)).cwiseMin(Vec3d(half.x(), half.y(), box.height));
        closest = std::min(closest, (q - inside).norm());
      }
    }
    const bool through = passes_through(point, box, margin);
    taken += through;
    if (closest <= margin.metres) {
      ++met;
      EXPECT_TRUE(through) << "trial " << trial;
    }
    // No beam is nearer than the sampled ones by more than twice the spread and the sampling step.
    if (closest > 2 * margin.beam_origin + margin.metres + 0.2) {
      ++near_miss;
      EXPECT_FALSE(through) << "trial " << trial;
    }
  }
  EXPECT_GT(met, 500);
  EXPECT_GT(near_miss, 100);
  EXPECT_LT(taken, 4000);
  EXPECT_FALSE(passes_through(Vec3d(NAN, 0, 0), random_box(random), {}));
}

TEST(RoofMask, HidesAllThatAnyObjectChanges) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3, true);
  FrameStore store(FrameSource{folder / "data", "ip-basic", "box"});
  const LidarModel lidar = lidar_of(folder / "data");
  CertificateSettings settings;
  settings.sizes = {0.2, 0.5, 0.8};
  settings.objects = 25;
  settings.adversaries = {random_adversary(3, limits_of_size(0.5))};
  settings.evaluation.quiet = true;
  DetectorPool detectors;
  detectors.push_back(std::make_unique<test::StandInDetector>());
  const std::vector<HostId> hosts = {{"000000", 0}, {"000001", 0}, {"000002", 0}};
  const CertificateResult result = certify(detectors, store, hosts, lidar, settings);
  ASSERT_EQ(result.shares.size(), 3u);
  for (const CertifiedShares& shares : result.shares) {
    EXPECT_EQ(shares.adversaries, shares.size > 0.4 ? 1 : 0);  // too large for the smallest box
    EXPECT_EQ(shares.objects, shares.adversaries > 0 ? 78u : 75u);
    EXPECT_EQ(shares.violations, 0u) << shares.size;
  }
  // The check notices what a mask leaves uncovered: objects of one size under the mask of a smaller size.
  const auto held = store.get("000000");
  const Placement roof = store.placement(hosts[0]);
  const Box3 small = object_box(roof.velo_from_adversary, limits_of_size(0.2));
  const MaskMargin margin{4, 0.02, beam_origin_spread(lidar)};
  const Frame& frame = held->frame;
  const Simulated attacked =
      simulate(*held, roof, random_adversary(1, limits_of_size(0.8)), settings.simulation);
  const MaskedFrame before = masked(frame.image, frame.sweep, frame.calibration, small, margin),
                    after = masked(attacked.image, attacked.sweep, frame.calibration, small, margin);
  EXPECT_NE(before.image.data, after.image.data);
  EXPECT_NE(before.sweep.size(), after.sweep.size());
}

TEST(Lattice, CoversEveryRoof) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 1);
  const Calibration calibration = read_frame(folder / "data", "000000").calibration;
  RandomStream random(5, "roofs");
  LatticeSettings settings;
  for (const double size : {0.2, 0.8}) {
    const AdversaryLimits limits = limits_of_size(size);
    const std::vector<Box3> masks = lattice(calibration, limits, -1.73, settings);
    EXPECT_GT(masks.size(), 100u);
    for (int trial = 0; trial < 500; ++trial) {
      const double range = random.uniform(5, settings.farthest - settings.step),
                   turn = random.uniform(-0.6, 0.6);
      const Transform roof(
          Eigen::Translation3d(range * std::cos(turn), range * std::sin(turn),
                               -1.73 + random.uniform(settings.roof_low, settings.roof_high)) *
          Eigen::AngleAxisd(random.uniform(-3, 3), Vec3d::UnitZ()));
      const Box3 box = object_box(roof, limits);
      EXPECT_TRUE(
          std::any_of(masks.begin(), masks.end(), [&](const Box3& mask) { return covers(mask, box); }));
      Box3 higher = box;
      higher.bottom += settings.roof_high;
      EXPECT_FALSE(
          std::any_of(masks.begin(), masks.end(), [&](const Box3& mask) { return covers(mask, higher); }));
    }
  }
}

/// Finds the first frame's car while one region has enough returns, and another has none.
class ReturnsDetector : public test::StandInDetector {
 public:
  enum class Looks { at_body, at_roof, at_low_roof };
  explicit ReturnsDetector(Looks looks) : looks_(looks) {}
  std::vector<Detection> forward(const SensorView& input, double, bool) override {
    int body = 0, roof = 0, high = 0;
    for (const LidarPoint& p : input.points) {
      if (std::hypot(p.x - 11.4, p.y) > 2.5) continue;
      body += p.z < -0.6 && p.z > -1.6, roof += p.z > 0, high += p.z > 0.3;
    }
    if (looks_ == Looks::at_body ? body < 10 : roof < 1) return {};
    if (looks_ == Looks::at_low_roof && high > 0) return {};
    return {{test::tiny_car(0), 3}};
  }

 private:
  Looks looks_;
};

/// Names a sensor that no mask covers.
class RadarReader : public test::StandInDetector {
 public:
  Capabilities capabilities() const override {
    Capabilities can = StandInDetector::capabilities();
    can.reads = {"lidar", "radar"};
    return can;
  }
};

TEST(Certificate, IsRefusedToADetectorThatReadsMoreThanTheMasksCover) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 1, true);
  FrameStore store(FrameSource{folder / "data", "ip-basic", "box"});
  DetectorPool detectors;
  detectors.push_back(std::make_unique<RadarReader>());
  EXPECT_THAT(test::error_text<InputError>([&] {
                certify(detectors, store, {{"000000", 0}}, lidar_of(folder / "data"), {});
              }),
              testing::HasSubstr("radar: is read by the detector"));
}

TEST(Certificate, IsForCarsThatAreFoundWithoutWhatStandsOnTheirRoof) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 1, true);
  Frame frame = read_frame(folder / "data", "000000");
  frame.sweep.push_back({11.2f, 0.f, 0.1f, 0.3f});  // a thing on the roof
  write_frame(folder / "data", frame);
  FrameStore store(FrameSource{folder / "data", "ip-basic", "box"});
  CertificateSettings settings;
  settings.sizes = {0.3, 0.6};
  settings.with_lattice = true;
  settings.lattice.farthest = 20;
  settings.objects = 0;
  settings.evaluation.quiet = true;
  for (const bool on_roof : {false, true}) {
    DetectorPool detectors;
    detectors.push_back(std::make_unique<ReturnsDetector>(on_roof ? ReturnsDetector::Looks::at_roof
                                                                  : ReturnsDetector::Looks::at_body));
    const CertificateResult result =
        certify(detectors, store, {{"000000", 0}}, lidar_of(folder / "data"), settings);
    EXPECT_GT(result.hosts.at(0).clean_iou, 0.9) << on_roof;
    for (const CertifiedShares& shares : result.shares) {
      EXPECT_EQ(shares.clean70.value, 1);
      EXPECT_EQ(shares.control70.value, on_roof ? 1 : 0);
      EXPECT_EQ(shares.covered, 1);
      EXPECT_EQ(shares.bands[0].known70.certified.value, on_roof ? 0 : 1) << shares.size;
      EXPECT_EQ(shares.bands[0].lattice70.certified.value, on_roof ? 0 : 1) << shares.size;
    }
    const nlohmann::json json = to_json(result, settings);
    EXPECT_EQ(json.at("sizes").size(), 2u);
    EXPECT_TRUE(json.at("outcomes").at(0).at("sizes").at(0).contains("lattice_iou"));
  }
  CertificateSettings bad = settings;
  bad.sizes = {-1};
  DetectorPool detectors;
  detectors.push_back(std::make_unique<ReturnsDetector>(ReturnsDetector::Looks::at_body));
  EXPECT_THAT(error_text<InputError>([&] {
                certify(detectors, store, {{"000000", 0}}, lidar_of(folder / "data"), bad);
              }),
              testing::StartsWith("sizes: -1: "));
}

TEST(Certificate, IsTheLowerEndOfABracketWhoseUpperEndIsUnderKnownObjects) {
  TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 1, true);
  Frame frame = read_frame(folder / "data", "000000");
  frame.sweep.push_back({11.2f, 0.f, 0.1f, 0.3f});  // a thing on the roof
  write_frame(folder / "data", frame);
  FrameStore store(FrameSource{folder / "data", "ip-basic", "box"});
  CertificateSettings settings;
  settings.sizes = {0.2, 0.8};
  settings.with_lattice = settings.whole_lattice = true;
  settings.lattice.farthest = 20;
  settings.objects = 0;
  settings.adversaries = {initial_adversary(limits_of_size(0.8), 1)};
  settings.evaluation.quiet = true;
  using Looks = ReturnsDetector::Looks;
  for (const auto& [looks, certified, attacked] :
       {std::tuple{Looks::at_body, 1, 1}, {Looks::at_roof, 0, 1}, {Looks::at_low_roof, 0, 0}}) {
    DetectorPool detectors;
    detectors.push_back(std::make_unique<ReturnsDetector>(looks));
    const CertificateResult result =
        certify(detectors, store, {{"000000", 0}}, lidar_of(folder / "data"), settings);
    const CertifiedShares &small = result.shares.at(0), &large = result.shares.at(1);
    EXPECT_EQ(small.adversaries, 0);
    EXPECT_EQ(large.adversaries, 1);
    const CertifiedBand &all = large.bands.at(0), &near = large.bands.at(1), &far = large.bands.at(2);
    EXPECT_EQ(all.hosts, 1);
    EXPECT_EQ(near.hosts, 1);
    EXPECT_EQ(far.hosts, 0);
    EXPECT_EQ(near.known50.certified.value, certified);
    EXPECT_EQ(near.known50.attacked.value, attacked);
    // The smallest box does not contain the object: no attack there is known to hide the car.
    EXPECT_EQ(small.bands.at(1).known50.attacked.value, 1);
    EXPECT_EQ(near.lattice50.certified.value, certified);
    EXPECT_GE(near.lattice50.attacked.value, attacked);

    // The evaluation's outcomes give the same result.
    EvaluationSettings by = settings.evaluation;
    const Evaluation evaluation =
        evaluate(detectors, store, {{"000000", 0}}, settings.adversaries.front(), settings.simulation, by);
    CertificateSettings known = settings;
    known.attacked = evaluation.hosts;
    EXPECT_EQ(to_json(certify(detectors, store, {{"000000", 0}}, lidar_of(folder / "data"), known), known),
              to_json(result, settings));
    known.adversaries.push_back(settings.adversaries.front());
    EXPECT_THROW(certify(detectors, store, {{"000000", 0}}, lidar_of(folder / "data"), known), FieldError);
  }
}

#ifdef MIRAGE_HAS_FUSION
TEST(Certificate, LocalPassesUnderAFewMasksCertifyTheCarsOfTheWholeLattice) {
  setenv("MIRAGE_HOME", MIRAGE_SOURCE, 1);
  setenv("MIRAGE_CACHE", "off", 0);
  TemporaryFolder folder;
  generate_dataset(read_rig(rig_file("kitti64")), 7, 0, 1, folder / "data", [](std::size_t) {});
  FrameStore store(FrameSource{folder / "data"});
  const LidarModel lidar = lidar_of(folder / "data");
  CertificateSettings settings;
  settings.sizes = {0.4};
  settings.with_lattice = true;
  settings.lattice = {.step = 4, .farthest = 48};
  settings.objects = 0;
  settings.evaluation.quiet = true;
  const auto certified = [&](int memory_mb, bool whole) {
    DetectorOptions options;
    options.rig = "kitti64";
    options.threads = 1;
    options.clean_memory_mb = memory_mb;
    DetectorPool detectors;
    detectors.push_back(load_detector(options));
    EXPECT_EQ(detectors.front()->capabilities().why_whole.empty(), memory_mb > 0);
    std::vector<HostId> hosts;
    for (const Host& host :
         find_all_hosts(store, {"000000"}, detectors.front()->region(), settings.simulation, 0.7))
      hosts.push_back(host.id);
    settings.whole_lattice = whole;
    return certify(detectors, store, hosts, lidar, settings);
  };
  const CertificateResult few = certified(2048, false), whole = certified(0, true);
  ASSERT_EQ(few.hosts.size(), whole.hosts.size());
  EXPECT_EQ(few.masks, whole.masks);
  EXPECT_TRUE(few.lattice_ap70.empty());
  EXPECT_EQ(whole.lattice_ap70.size(), 1u);
  int certain = 0, covered = 0;
  for (std::size_t h = 0; h < few.hosts.size(); ++h) {
    const Certificate &a = few.hosts[h].sizes.at(0), &b = whole.hosts[h].sizes.at(0);
    EXPECT_EQ(a.covered, b.covered) << h;
    EXPECT_LT(a.lattice_iou, b.lattice_iou + 1e-4) << h;
    EXPECT_NEAR(a.with_roof_iou, b.with_roof_iou, 1e-4) << h;
    for (const double iou : {0.5, 0.7}) EXPECT_EQ(a.lattice_iou > iou, b.lattice_iou > iou) << h;
    covered += a.covered, certain += a.lattice_iou > 0.5;
  }
  EXPECT_GT(covered, 1);
  EXPECT_GT(certain, 0);
}
#endif

}  // namespace
}  // namespace mirage
