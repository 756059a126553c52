// Streaming of frames, and the parts of them that are cached on disk.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <chrono>
#include <cstdlib>
#include <functional>
#include <numeric>
#include <thread>

#include "attack/attack.h"
#include "attack/evaluation.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/sizes.h"
#include "detection/audit.h"
#include "frames/frame_cache.h"
#include "frames/frame_provenance.h"
#include "frames/frame_store.h"
#include "frames/hosts.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "support/each_field.h"
#include "support/files.h"
#include "support/heard.h"
#include "support/layouts.h"
#include "support/small_rig.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using test::Heard;
using testing::HasSubstr;

/// MIRAGE_CACHE for a test's duration.
class CacheIn {
 public:
  explicit CacheIn(const fs::path& folder) { setenv("MIRAGE_CACHE", folder.c_str(), 1); }
  ~CacheIn() { setenv("MIRAGE_CACHE", "off", 1); }
};

/// All results of a store's frames that could differ, bit by bit.
std::string classify(FrameStore& store, const std::vector<std::string>& ids) {
  std::string text;
  const auto add = [&](const void* bytes, std::size_t size) {
    text.append(static_cast<const char*>(bytes), size);
  };
  for (const std::string& id : ids) {
    for (const HostView& view : store.views(id, {0, 50, -25, 25}, {})) add(&view.share, sizeof view.share);
    const auto frame = store.get(id);
    for (std::size_t i = 0; i < frame->frame.labels.size(); ++i) {
      if (!has_box(frame->frame.labels[i])) continue;
      const Carrier carrier = *store.placement({id, static_cast<int>(i)}).carrier;
      add(carrier.velo_from_roof.matrix().data(), 16 * sizeof(double));
      text += carrier.reason + (carrier.from_box ? "box" : "fitted");
      if (!carrier.shape) continue;
      for (const Vec3d& v : carrier.shape->vertices) add(v.data(), 3 * sizeof(double));
      for (const Face& f : carrier.shape->faces) add(f.data(), 3 * sizeof(int));
    }
    add(frame->depth.data.data(), frame->depth.data.size() * sizeof(float));
    add(frame->frame.sweep.data(), frame->frame.sweep.size() * sizeof(LidarPoint));
    add(frame->frame.image.data.data(), frame->frame.image.data.size() * sizeof(float));
  }
  return text;
}

std::vector<fs::path> entries(const fs::path& folder, const std::string& kind) {
  std::vector<fs::path> found;
  if (fs::exists(folder / kind))
    for (const auto& entry : fs::directory_iterator(folder / kind)) found.push_back(entry.path());
  return found;
}

class FrameStoreTest : public testing::Test {
 protected:
  void SetUp() override { test::write_tiny_data(data_, 3, true); }
  FrameStore store() const { return FrameStore(FrameSource{data_, "ip-basic", "shape"}); }
  std::string all(FrameStore& of) const { return classify(of, {"000000", "000001", "000002"}); }
  std::string without_cache() const {
    setenv("MIRAGE_CACHE", "off", 1);
    FrameStore plain = store();
    return all(plain);
  }

  test::TemporaryFolder folder_;
  fs::path data_ = folder_ / "data", cache_ = folder_ / "cache";
};

TEST_F(FrameStoreTest, HoldsNoMoreThanItsLimitAndGivesTheSameBits) {
  FrameStore roomy = store(), tight = store();
  const std::string bits = all(roomy);
  EXPECT_EQ(roomy.reads(), 3u);
  const std::size_t frame = roomy.memory() / 3;
  tight.set_memory_limit(frame + frame / 2);
  EXPECT_EQ(all(tight), bits);
  EXPECT_EQ(all(tight), bits);
  EXPECT_GT(tight.reads(), 3u);  // read again
  EXPECT_LE(tight.memory(), frame + frame / 2);
  EXPECT_GT(tight.memory(), 0u);
}

TEST_F(FrameStoreTest, WhatIsUsedLastStaysAndAFrameInUseIsNeverReadAgain) {
  FrameStore frames = store();
  const auto first = frames.get("000000");
  const std::size_t frame = frames.memory();
  frames.set_memory_limit(2 * frame + frame / 2);
  frames.get("000001");
  frames.get("000000");
  frames.get("000002");  // drops 000001
  EXPECT_EQ(frames.reads(), 3u);
  frames.get("000000");
  frames.get("000002");
  EXPECT_EQ(frames.reads(), 3u);
  frames.get("000001");
  EXPECT_EQ(frames.reads(), 4u);
  frames.set_memory_limit(0);
  EXPECT_EQ(frames.memory(), 0u);
  EXPECT_EQ(frames.get("000000").get(), first.get());  // alive, though no longer held
  EXPECT_EQ(frames.reads(), 4u);
}

TEST_F(FrameStoreTest, ReadsAhead) {
  FrameStore frames = store();
  frames.set_memory_limit(0);  // only what is wanted next is alive
  frames.prefetch({"000001", "no such frame", "000002"});
  for (int i = 0; i < 2000 && frames.reads() < 2; ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  EXPECT_EQ(frames.reads(), 2u);
  frames.get("000001");
  EXPECT_EQ(frames.reads(), 2u);
  EXPECT_THROW(frames.get("no such frame"), InputError);
}

TEST_F(FrameStoreTest, ManyThreadsReadAFrameOnce) {
  FrameStore frames = store();
  std::vector<std::thread> threads;
  std::vector<std::shared_ptr<const PreparedFrame>> got(6);
  for (std::size_t i = 0; i < got.size(); ++i)
    threads.emplace_back([&, i] { got[i] = frames.get(i % 2 ? "000001" : "000000"); });
  for (auto& thread : threads) thread.join();
  EXPECT_EQ(frames.reads(), 2u);
  EXPECT_EQ(got[0].get(), got[4].get());
  EXPECT_EQ(got[1].get(), got[5].get());
}

TEST_F(FrameStoreTest, TheDiskCacheChangesNoBitAndSparesTheWork) {
  const std::string bits = without_cache();
  const CacheIn here(cache_);
  FrameStore cold = store();
  EXPECT_EQ(all(cold), bits);
  EXPECT_EQ(entries(cache_, "depth").size(), 3u);
  EXPECT_EQ(entries(cache_, "rooftops").size(), 3u);
  EXPECT_EQ(entries(cache_, "views").size(), 3u);
  FrameStore warm = store();
  EXPECT_EQ(all(warm), bits);
  // Finding hosts reads no frame.
  FrameStore hosts = store();
  const auto found =
      find_all_hosts(hosts, {"000000", "000001", "000002"}, {0, 50, -25, 25}, SimulationSettings(), 0.7);
  EXPECT_EQ(found.size(), 3u);
  EXPECT_EQ(hosts.reads(), 0u);
  EXPECT_FALSE(found[0].from_box);
  EXPECT_NE(hosts.placement(found[0].id).carrier->shape, nullptr);
}

TEST_F(FrameStoreTest, TheObjectIsWhereTheSourceSays) {
  const CacheIn here(cache_);
  FrameSource source{data_, "ip-basic", "shape"};
  FrameStore roof(source);
  EXPECT_EQ(roof.placement({"000000", 0}).support, Support::roof);
  const double on_roof = roof.views("000000", {0, 50, -25, 25}, {}).at(0).share;
  source.placement = {PlaceChoice::In::vehicle, Vec3d(30, 0, 0), 0};  // behind the car
  FrameStore behind(source);
  const Placement placement = behind.placement({"000000", 0});
  EXPECT_EQ(placement.support, Support::free);
  EXPECT_NE(placement.carrier->shape, nullptr);
  EXPECT_NE(behind.views("000000", {0, 50, -25, 25}, {}).at(0).share, on_roof);
  EXPECT_EQ(entries(cache_, "rooftops").size(), 1u);  // of the vehicle, wherever the object is placed
  EXPECT_EQ(entries(cache_, "views").size(), 2u);
}

TEST_F(FrameStoreTest, KeysAreContentAndSettings) {
  const CacheIn here(cache_);
  FrameStore first = store();
  all(first);
  const auto depths = [&] { return entries(cache_, "depth").size(); };
  const auto views = [&] { return entries(cache_, "views").size(); };
  ASSERT_EQ(depths(), 3u);
  // The same files in another folder are the same frames.
  fs::copy(data_, folder_ / "copy", fs::copy_options::recursive);
  FrameStore copy(FrameSource{folder_ / "copy", "ip-basic", "shape"});
  all(copy);
  EXPECT_EQ(depths(), 3u);
  // Another roof finder, region or camera gives other results.
  FrameStore box(FrameSource{data_, "ip-basic", "box"});
  box.views("000000", {0, 50, -25, 25}, {});
  EXPECT_EQ(entries(cache_, "rooftops").size(), 4u);
  EXPECT_EQ(views(), 4u);
  box.views("000000", {0, 51, -25, 25}, {});
  EXPECT_EQ(views(), 5u);
  SimulationSettings soft;
  soft.raster.sigma *= 2;
  box.views("000000", {0, 50, -25, 25}, soft);
  EXPECT_EQ(views(), 6u);
  FrameStore multiscale(FrameSource{data_, "ip-basic-multiscale", "box"});
  multiscale.get("000000");
  EXPECT_EQ(depths(), 4u);
  // A changed file makes another frame.
  const fs::path sweep = data_ / "training/velodyne/000000.bin";
  std::string bytes = read_file(sweep);
  write_file(sweep, bytes.substr(16));
  FrameStore changed = store();
  changed.get("000000");
  EXPECT_EQ(depths(), 5u);
  // The light on the object is the frame's own.
  const std::string before = store().content("000000");
  Lighting dusk = changed.get("000000")->frame.lighting;
  dusk.sun *= 0.1;
  write_json(lighting_file(data_, "000000"), to_json(dusk));
  EXPECT_NE(store().content("000000"), before);
}

TEST_F(FrameStoreTest, DamagedEntriesAreComputedAgainWithOneWarning) {
  const std::string bits = without_cache();
  const CacheIn here(cache_);
  FrameStore cold = store();
  all(cold);
  const auto damage = [&](const std::string& kind, const std::function<std::string(std::string)>& change) {
    for (const fs::path& file : entries(cache_, kind)) write_file(file, change(read_file(file)));
  };
  for (const std::string kind : {"depth", "rooftops", "views"}) {
    const std::vector<std::function<std::string(std::string)>> ways = {
        [](std::string s) { return s.substr(0, s.size() / 2); },
        [](std::string s) { return s.substr(0, 7); },
        [](std::string) { return std::string(); },
        [](std::string s) { return s[s.size() - 3] = static_cast<char>(s[s.size() - 3] ^ 4), s; },
        [](std::string s) { return s[10] = '\x7f', s; },  // the sizes
        [](std::string s) { return s + "more"; }};
    for (const auto& way : ways) {
      damage(kind, way);
      const Heard heard;
      FrameStore frames = store();
      EXPECT_EQ(all(frames), bits) << kind;
      EXPECT_EQ(heard.warnings(), 1) << kind << "\n" << heard.text();
      EXPECT_THAT(heard.text(), HasSubstr("damaged cache entry"));
      const Heard after;
      FrameStore mended = store();
      EXPECT_EQ(all(mended), bits) << kind;
      EXPECT_EQ(after.warnings(), 0) << after.text();
    }
  }
}

TEST_F(FrameStoreTest, APipeInThePlaceOfAnEntryIsDamageAndIsNotWaitedFor) {
  const std::string bits = without_cache();
  const CacheIn here(cache_);
  FrameStore cold = store();
  all(cold);
  for (const fs::path& file : entries(cache_, "depth")) {
    fs::remove(file);
    ASSERT_EQ(mkfifo(file.c_str(), 0600), 0);
  }
  const Heard heard;
  FrameStore frames = store();
  EXPECT_EQ(all(frames), bits);
  EXPECT_THAT(heard.text(), HasSubstr("damaged cache entry"));
}

TEST_F(FrameStoreTest, AFolderThatCannotBeWrittenCostsOneWarning) {
  const std::string bits = without_cache();
  write_file(folder_ / "file", "not a folder");
  const CacheIn here(folder_ / "file");
  const Heard heard;
  FrameStore frames = store();
  EXPECT_EQ(all(frames), bits);
  EXPECT_EQ(heard.warnings(), 1) << heard.text();
  EXPECT_THAT(heard.text(), HasSubstr("nothing more is cached"));
}

/// Whether a cache folder has the entry for the given inputs; stores it if not.
class Entries {
 public:
  explicit Entries(const fs::path& folder) : folder_(folder) {}
  bool views(const SimulationSettings& simulation, const LidarModel& lidar = {},
             const std::string& depth = "ip-basic", const std::string& rooftop = "box",
             const std::string& frame = "f", double left = 0) const {
    FrameCache cache(std::make_unique<DiskCache>(folder_), depth, rooftop, lidar);
    bool asked = false;
    cache.views(frame, {}, {left, 50, -25, 25}, simulation, [&] {
      asked = true;
      return std::vector<HostView>{{1, 0.5}};
    });
    return !asked;
  }

 private:
  fs::path folder_;
};

TEST(FrameCache, AnEntryIsOfOneFrameModelAndSetting) {
  const test::TemporaryFolder folder;
  const Entries kept(folder / "cache");
  const SimulationSettings settings;
  EXPECT_FALSE(kept.views(settings));
  EXPECT_TRUE(kept.views(settings));
  int fields = 0;
  test::for_each_field(settings,
                       [&](SimulationSettings& other, const Field& field, auto& value, bool, const char*) {
                         test::change(field, value);
                         // Lens, sensor and LiDAR effects change no silhouette.
                         SimulationSettings plain = other;
                         plain.lidar_effects = {};
                         plain.camera_effects = {};
                         const bool same = fields_json(plain) == fields_json(settings);
                         EXPECT_EQ(kept.views(other), same) << field.name;
                         EXPECT_TRUE(kept.views(other)) << field.name;
                         fields += same ? 0 : 1;
                       });
  EXPECT_GT(fields, 25);
  LidarModel unit;
  unit.beams.resize(2);
  EXPECT_FALSE(kept.views(settings, unit));
  const auto changed = [&](const char* what, const auto& change) {
    LidarModel other = unit;
    change(other);
    EXPECT_FALSE(kept.views(settings, other)) << what;
  };
  double LidarBeam::*const of_beam[] = {&LidarBeam::elevation, &LidarBeam::height, &LidarBeam::lateral,
                                        &LidarBeam::azimuth_offset, &LidarBeam::time};
  for (const auto number : of_beam) changed("beam", [&](LidarModel& m) { m.beams[1].*number = 0.1; });
  double LidarModel::*const of_unit[] = {&LidarModel::azimuth_step, &LidarModel::encoder_step,
                                         &LidarModel::azimuth_min,  &LidarModel::azimuth_max,
                                         &LidarModel::range_min,    &LidarModel::range_max,
                                         &LidarModel::rate,         &LidarModel::height};
  for (const auto number : of_unit) changed("unit", [&](LidarModel& m) { m.*number = 0.1; });
  changed("rotation", [](LidarModel& m) { m.rotation = -1; });
  changed("divergence", [](LidarModel& m) { m.divergence.y() = 1e-3; });
  changed("mount", [](LidarModel& m) { m.velo_from_lidar.translation().x() = 1; });
  EXPECT_FALSE(kept.views(settings, unit, "guided"));
  EXPECT_FALSE(kept.views(settings, unit, "ip-basic", "shape"));
  EXPECT_FALSE(kept.views(settings, unit, "ip-basic", "box", "g"));
  EXPECT_FALSE(kept.views(settings, unit, "ip-basic", "box", "f", 1));
}

TEST_F(FrameStoreTest, CleanDetectionsAreKeptByDetectorAndThreshold) {
  const CacheIn here(cache_);
  FrameStore frames = store();
  int asked = 0;
  const auto detect = [&](const Frame& frame) {
    ++asked;
    return std::vector<Detection>{{{frame.labels[0].box.bev.x, 1, 2, 3, 0.1}, 0.3},
                                  {{5, 1, 2, 3, 0.1}, 1e-300}};
  };
  const auto first = cached_detections(frames, "000001", "one", 0.3, detect);
  FrameStore later = store();
  const auto again = cached_detections(later, "000001", "one", 0.3, detect);
  EXPECT_EQ(asked, 1);
  EXPECT_EQ(later.reads(), 0u);
  ASSERT_EQ(again.size(), 2u);
  for (std::size_t i = 0; i < again.size(); ++i) {
    EXPECT_EQ(again[i].box.bev.x, first[i].box.bev.x);
    EXPECT_EQ(again[i].box.bev.yaw, first[i].box.bev.yaw);
    EXPECT_EQ(again[i].logit, first[i].logit);
  }
  cached_detections(later, "000001", "two", 0.3, detect);
  cached_detections(later, "000001", "one", 0.2, detect);
  cached_detections(later, "000002", "one", 0.3, detect);
  EXPECT_EQ(asked, 4);
  cached_detections(later, "000001", "", 0.3, detect);  // without a version nothing is stored
  cached_detections(later, "000001", "", 0.3, detect);
  EXPECT_EQ(asked, 6);
}

TEST(DetectorIdentity, IsPluginWeightsAndDefence) {
  test::TemporaryFolder folder;
  DetectorOptions options;
  options.detector = (folder / "one.so").string();
  options.weights = folder / "one.weights";
  write_file(options.detector, "code");
  write_file(options.weights, "numbers");
  const std::string known = detector_identity(options);
  EXPECT_EQ(detector_identity(options), known);
  DetectorOptions defended = options;
  defended.defense = "jpeg:50";
  EXPECT_NE(detector_identity(defended), known);
  write_file(options.weights, "other numbers");
  const std::string retrained = detector_identity(options);
  EXPECT_NE(retrained, known);
  write_file(options.detector, "other code");
  EXPECT_NE(detector_identity(options), retrained);
  options.fresh = true;
  EXPECT_EQ(detector_identity(options), "");
}

TEST(DiskCache, WhatWasNotUsedForLongestGoesFirst) {
  test::TemporaryFolder folder;
  DiskCache cache(folder / "cache", 10000);
  const std::string kilobyte(1000, 'x');
  write_file(folder / "cache/mine.txt", std::string(20000, 'm'));  // not the cache's
  const auto age = [&](int minutes) {
    for (const auto& file : entries(folder / "cache", "kind"))
      if (fs::last_write_time(file) > fs::file_time_type::clock::now() - std::chrono::minutes(1))
        fs::last_write_time(file, fs::file_time_type::clock::now() - std::chrono::minutes(minutes));
  };
  for (int i = 0; i < 8; ++i) {
    cache.write("kind", std::to_string(i), kilobyte);
    age(100 - i);
  }
  EXPECT_TRUE(cache.read("kind", "0"));  // used again
  for (int i = 8; i < 14; ++i) {
    cache.write("kind", std::to_string(i), kilobyte);
    age(100 - i);
  }
  std::uint64_t total = 0;
  for (const auto& file : entries(folder / "cache", "kind")) total += fs::file_size(file);
  EXPECT_LE(total, 11000u);
  EXPECT_FALSE(cache.read("kind", "1"));
  EXPECT_TRUE(cache.read("kind", "13"));
  EXPECT_EQ(read_file(folder / "cache/mine.txt").size(), 20000u);
}

TEST(DiskCache, TheEnvironmentNamesTheFolder) {
  test::TemporaryFolder folder;
  const char* home = std::getenv("HOME");
  const std::string before = home ? home : "";
  const auto made_in = [&](const fs::path& place) {
    DiskCache::from_environment()->write("kind", "key", "value");
    return fs::exists(place / "kind");
  };
  setenv("MIRAGE_CACHE", (folder / "named").c_str(), 1);
  EXPECT_TRUE(made_in(folder / "named"));
  unsetenv("MIRAGE_CACHE");
  setenv("XDG_CACHE_HOME", (folder / "xdg").c_str(), 1);
  EXPECT_TRUE(made_in(folder / "xdg/mirage"));
  unsetenv("XDG_CACHE_HOME");
  setenv("HOME", (folder / "home").c_str(), 1);
  EXPECT_TRUE(made_in(folder / "home/.cache/mirage"));
  setenv("MIRAGE_CACHE", "off", 1);
  EXPECT_FALSE(DiskCache::from_environment()->on());
  setenv("HOME", before.c_str(), 1);
}

TEST(AttackCache, RunsWithAndWithoutItLearnTheSameBits) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 3, true);
  const auto run = [&](const char* out, int iterations) {
    DetectorPool detectors;
    for (int i = 0; i < 2; ++i) detectors.push_back(std::make_unique<test::StandInDetector>());
    AttackSettings settings = test::tiny_attack();
    settings.data = folder / "data";
    settings.out = folder / out;
    settings.iterations = iterations;
    settings.batch = 3;
    settings.quiet = true;
    const AttackResult result = run_attack(settings, detectors);
    EXPECT_EQ(result.rooftops.fitted, 3);
    return result;
  };
  setenv("MIRAGE_CACHE", "off", 1);
  const auto plain = run("plain", 4);
  const auto& wall = plain.stages.at("wall_seconds");
  const auto& thread = plain.stages.at("thread_seconds");
  EXPECT_GT(thread.at("simulation_forward").get<double>(), 0);
  EXPECT_GT(thread.at("detector_forward").get<double>(), 0);
  EXPECT_LE(wall.at("hosts").get<double>(), wall.at("total").get<double>());
  EXPECT_NEAR(wall.at("total").get<double>(), plain.seconds_per_iteration, 1e-9);
  const CacheIn here(folder / "cache");
  run("cold", 4);
  run("warm", 2);
  run("warm", 4);
  for (const char* out : {"cold", "warm"})
    for (const char* file : {"adversary.glb", "loss.csv", "run.json"})
      EXPECT_EQ(read_file(folder / out / file), read_file(folder / "plain" / file)) << out << " " << file;
}

// Hosts and truth have the requested classes, by default a car's.
TEST(Classes, AreHostsAndHaveToBeFoundAsAsked) {
  const test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 1);
  Frame frame = read_frame(folder / "data", "000000");
  for (const auto& [type, y] : {std::pair("Truck", 5.0), std::pair("Pedestrian", -5.0)}) {
    Label& other = frame.labels.emplace_back(frame.labels[0]);
    other.type = type;
    other.box.bev.y = y, other.box.bev.x += 6;
  }
  write_frame(folder / "data", frame);
  FrameSource source;
  source.data = folder / "data";
  source.depth = "ip-basic";
  source.rooftop = "box";
  const CacheIn cache(folder / "cache");
  const std::array<double, 4> region = {0, 60, -30, 30};
  const auto types = [&](const std::string& classes) {
    source.classes = classes;
    FrameStore store(source);
    std::vector<std::string> hosts, found;
    const auto held = store.get("000000");
    for (const Host& host : find_hosts(store, "000000", region, {}, 0.1))
      hosts.push_back(label_of(held->frame, host.id).type);
    for (const TruthBox& box : ground_truth(held->frame, region).space.boxes)
      found.push_back(held->frame.labels[box.label].type);
    EXPECT_EQ(hosts, found);
    return hosts;
  };
  using Types = std::vector<std::string>;
  EXPECT_EQ(types("Car"), Types({"Car"}));
  EXPECT_EQ(types("truck,Pedestrian"), Types({"Truck", "Pedestrian"}));
  EXPECT_EQ(types("Car,Truck"), Types({"Car", "Truck"}));
  const std::vector<std::string> ids = {"000000"};
  EXPECT_EQ(count_labels(source.data, ids, "Truck,Pedestrian").cars, 2);
  EXPECT_THAT(test::error_text<InputError>(
                  [&] { require_cars(count_labels(source.data, ids, "Tram"), "an attack"); }),
              testing::AllOf(testing::HasSubstr("count as a Tram"), testing::HasSubstr("1 Truck")));
  EXPECT_THAT(test::error_text<FieldError>([&] { count_labels(source.data, ids, "Car,Truk"); }),
              testing::AllOf(testing::HasSubstr("classes: Truk"), testing::HasSubstr("Truck"),
                             testing::HasSubstr("Pedestrian")));
  EXPECT_THROW(classes_of(" ,"), FieldError);
}

// In a set with all cameras the sweep is whole, and the other cameras' depths are cached by name.
TEST(SurroundFrames, DepthsOfOtherCamerasAreKept) {
  const test::TemporaryFolder folder;
  test::write_nuscenes(folder / "data", {test::surround_frame(test::small_rig(), 5, 0)});
  const CacheIn cache(folder / "cache");
  FrameSource source;
  source.data = folder / "data";
  source.depth = "ip-basic";
  source.rooftop = "box";
  FrameStore first(source);
  source.cameras = Cameras::all;
  const Frame recorded = read_frame(source.data, "sample0", Cameras::all);
  std::vector<ImageF> depths;
  for (int again = 0; again < 2; ++again) {
    FrameStore store(source);
    const auto frame = store.get("sample0");
    EXPECT_EQ(frame->frame.sweep.size(), recorded.sweep.size());
    EXPECT_LT(first.get("sample0")->frame.sweep.size(), recorded.sweep.size());
    EXPECT_EQ(entries(folder / "cache", "depth").size(), again == 0 ? 2u : 4u);  // of both stores' first
    ASSERT_EQ(frame->other_depths.size(), 2u);
    for (const Lazy<ImageF>& depth : frame->other_depths) {
      if (again == 0)
        depths.push_back(depth.get());
      else
        EXPECT_EQ(depth.get().data, depths[as_size(&depth - frame->other_depths.data())].data);
    }
    const PreparedFrame alone = prepare(recorded, frame->lidar);
    for (std::size_t k = 1; k < 3; ++k) EXPECT_EQ(alone.depth_of(k).data, frame->depth_of(k).data);
  }
}

/// Reads the rear camera: its confidence in the host depends on that camera's mean brightness.
class LooksBack : public Detector {
 public:
  explicit LooksBack(const BevBox& host) : host_(host) {}
  std::string name() const override { return "looks back"; }
  Capabilities capabilities() const override {
    Capabilities can;
    can.reads = {"CAM_BACK"};
    return can;
  }
  std::array<double, 4> region() const override { return {-60, 60, -60, 60}; }
  std::vector<Detection> forward(const SensorView& view, double, bool) override {
    double mean = -1;
    for (const SensorData& sensor : sensors(view, capabilities(), "test"))
      if (sensor.name == "CAM_BACK" && sensor.image)
        mean = std::accumulate(sensor.image->data.begin(), sensor.image->data.end(), 0.0) /
               static_cast<double>(sensor.image->data.size());
    seen.push_back(mean);
    return {Detection(host_, 1 + mean)};
  }
  SensorGradient backward(std::span<const double>) override { return {}; }
  TrainingLoss train_step(std::span<const TrainingSample>, double) override { return {}; }
  void save(const std::filesystem::path&, bool) override {}

  std::vector<double> seen;  ///< the camera's mean brightness by pass; −1: no picture

 private:
  BevBox host_;
};

// An evaluation draws the object in every camera that the detector reads, not only in the first.
TEST(SurroundFrames, AnEvaluationShowsTheObjectInTheCamerasThatTheDetectorReads) {
  const test::TemporaryFolder folder;
  test::write_nuscenes(folder / "data", {test::surround_frame(test::small_rig(), 5, 0)});
  FrameSource source;
  source.data = folder / "data";
  source.depth = "ip-basic";
  source.rooftop = "box";
  source.cameras = Cameras::all;
  FrameStore store(source);
  const auto frame = store.get("sample0");
  TexturedMesh black = grey_ellipsoid(kRoofBox);
  for (Vec3d& texel : black.atlas.texels) texel.setZero();
  int behind = 0;
  for (const Host& host : find_hosts(store, "sample0", {-60, 60, -60, 60}, {}, 0)) {
    const Simulated seen = simulate(*frame, store.placement(host.id), black, {});
    DetectorPool pool;
    pool.push_back(std::make_unique<LooksBack>(label_of(frame->frame, host.id).box.bev));
    const HostOutcome outcome = evaluate(pool, store, {host.id}, black, {}, {}).hosts.at(0);
    const bool shown = seen.others.at(0).adversary_pixels > 0;
    behind += shown;
    EXPECT_EQ(outcome.attacked_score != outcome.clean_score, shown) << host_name(host.id);
  }
  EXPECT_GT(behind, 0);
}

// The gate swaps and blackens the pictures of every camera that the detector reads.
TEST(SurroundFrames, TheGateChangesThePicturesOfTheCamerasThatTheDetectorReads) {
  const test::TemporaryFolder folder;
  test::write_nuscenes(folder / "data", {test::surround_frame(test::small_rig(), 5, 0),
                                         test::surround_frame(test::small_rig(), 5, 1)});
  FrameSource source;
  source.data = folder / "data";
  source.cameras = Cameras::all;
  const Frame frame = read_frame(source.data, "sample0", Cameras::all);
  LooksBack detector(frame.labels.at(0).box.bev);
  Detector* const only[] = {&detector};
  const std::vector<AuditChange> changes = gate_changes();
  run_audit(only, recorded_frames(source), list_frames(source.data), changes);
  // In each frame: as recorded, another frame's, black, none.
  ASSERT_EQ(detector.seen.size(), 8u);
  for (std::size_t f = 0; f < 2; ++f) {
    const double* here = &detector.seen[4 * f];
    EXPECT_GT(here[0], 0);
    EXPECT_EQ(here[1], detector.seen[4 * (1 - f)]);
    EXPECT_NE(here[1], here[0]);
    EXPECT_EQ(here[2], 0);
    EXPECT_EQ(here[3], -1);
  }
}

// A vehicle outside the first camera's view can be a host if another camera shows enough of the object.
TEST(SurroundFrames, HostsAreThoseThatAnyCameraSees) {
  if (test::real_surround().empty())
    GTEST_SKIP() << "no real frames: set MIRAGE_NUSCENES to a nuScenes folder";
  FrameSource source;
  source.data = test::real_surround();
  source.depth = "ip-basic";
  source.rooftop = "box";
  const std::string id = list_frames(source.data).at(0);
  const std::array<double, 4> everywhere = {-60, 60, -60, 60};
  FrameStore first(source);
  const auto in_front = find_hosts(first, id, everywhere, {}, 0.5);
  source.cameras = Cameras::all;
  FrameStore store(source);
  const auto frame = store.get(id);
  ASSERT_EQ(frame->frame.cameras(), 6u);
  int behind = 0;
  const auto hosts = find_hosts(store, id, everywhere, {}, 0.5);
  EXPECT_GT(hosts.size(), in_front.size());
  for (const Host& host : hosts) {
    const Simulated seen = simulate(*frame, store.placement(host.id), grey_ellipsoid(kRoofBox), {});
    const Label& label = label_of(frame->frame, host.id);
    if (label.camera == 0 || label.box.bev.x > 0 || seen.adversary_points == 0) continue;
    ++behind;
    EXPECT_EQ(seen.adversary_pixels, 0) << host_name(host.id);
    EXPECT_TRUE(seen.image.data == frame->frame.image.data);
    EXPECT_GT(seen.best_share(), 0.5);
    int cameras = 0;
    for (const CameraSight& sight : seen.others) cameras += sight.adversary_pixels > 0;
    EXPECT_GE(cameras, 1);
  }
  EXPECT_GE(behind, 1);
}

}  // namespace
}  // namespace mirage
