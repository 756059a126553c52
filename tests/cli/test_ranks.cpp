// `mpirun -n N mirage attack`: the same bits for any number of processes, and the files that remain when one
// dies. Commands that share frames and vehicles, and the parallel steps of `mirage reproduce`.
#include <atomic>
#include <chrono>
#include <thread>

#include "base/sizes.h"
#include "program.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

class Ranks : public test::Program {
 protected:
  void SetUp() override {
    MIRAGE_NEED_FUSION();
    if (shell("mpirun --version") != 0) GTEST_SKIP() << "mpirun is not installed (openmpi-bin)";
    ASSERT_TRUE(fs::exists(frames_)) << "ctest makes them (frames.generated)";
  }
  /// Open MPI refuses root and more processes than cores by default, and leaks memory of its own.
  std::string on_ranks(int ranks, const std::string& arguments) const {
    const char* sanitizer = std::getenv("ASAN_OPTIONS");
    return "OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 ASAN_OPTIONS=" +
           std::string(sanitizer ? sanitizer : "") + ":detect_leaks=0 mpirun --oversubscribe -n " +
           std::to_string(ranks) + " " + command(arguments);
  }
  int mirage_on(int ranks, const std::string& arguments) const { return shell(on_ranks(ranks, arguments)); }
  std::string attack(const std::string& out, int iterations) const {
    return "attack --batch 4 --expect all --threads 1 --data " + frames_ + " --iterations " +
           std::to_string(iterations) + " --out " + at(out);
  }
  /// Attacks with the same options on one process and on two, and expects equal meshes and an equal `report`
  /// in result.json, which it returns.
  nlohmann::json learn_on_one_and_two(int iterations, const std::string& options,
                                      const std::string& report) const {
    EXPECT_EQ(mirage(attack("one", iterations) + options), 0) << said();
    EXPECT_EQ(mirage_on(2, attack("two", iterations) + options), 0) << said();
    EXPECT_EQ(text("two/adversary.glb"), text("one/adversary.glb"));
    const nlohmann::json on_one = json("one/result.json").at(report);
    EXPECT_EQ(json("two/result.json").at(report), on_one);
    return on_one;
  }
  static nlohmann::json without_times(nlohmann::json of) {
    if (of.is_object())
      for (const char* key : {"seconds", "seconds_per_frame"}) of.erase(key);
    for (nlohmann::json& part : of)
      if (part.is_structured()) part = without_times(std::move(part));
    return of;
  }
  /// result.json without its times and provenance.
  nlohmann::json result(const std::string& out) const {
    nlohmann::json read = json(out + "/result.json");
    read.erase("provenance");
    return without_times(std::move(read));
  }
  int with_cache(const std::string& line) const {
    return shell("export MIRAGE_CACHE=" + at("cache") + "; " + line);
  }
  /// Number of cached answers of a kind.
  std::size_t kept(const std::string& kind) const {
    const fs::path folder = folder_ / "cache" / kind;
    return fs::exists(folder) ? as_size(std::distance(fs::directory_iterator(folder), {})) : 0;
  }
  /// Runs a command on one process and on three, and once more where one of the answers of this kind that
  /// they keep is missing: it goes on. All give one result, and this is it.
  nlohmann::json same_on_one_and_three(const std::string& line, const std::string& kind) const {
    const auto to = [&](const std::string& out) { return line + " --threads 1 --out " + at(out); };
    EXPECT_EQ(mirage(to("alone")), 0) << said();
    const nlohmann::json alone = result("alone");
    EXPECT_EQ(with_cache(on_ranks(3, to("three"))), 0) << said();
    EXPECT_EQ(result("three"), alone);
    const std::size_t all = kept(kind);
    if (all < 2)
      ADD_FAILURE() << all << " answers were kept";
    else
      fs::remove(*fs::directory_iterator(folder_ / "cache" / kind));
    EXPECT_EQ(with_cache(command(to("again"))), 0) << said();
    EXPECT_EQ(result("again"), alone);
    EXPECT_EQ(kept(kind), all);
    return alone;
  }
  /// Two attacks and their evaluations.
  std::string reproduce(const std::string& out) const {
    return "reproduce table1 --quick --iterations 1 --threads 1 --kitti64 " + frames_ +
           " --only kitti64-lidar-lidar,kitti64-fusion-lidar --out " + at(out);
  }
};

TEST_F(Ranks, OneTwoAndFourProcessesLearnTheSameBits) {
  ASSERT_EQ(mirage(attack("one", 3)), 0) << said();
  for (const int ranks : {2, 4}) {
    const std::string out = "on" + std::to_string(ranks);
    ASSERT_EQ(mirage_on(ranks, attack(out, 3)), 0) << said();
    EXPECT_EQ(text(out + "/adversary.glb"), text("one/adversary.glb"));
    EXPECT_EQ(text(out + "/loss.csv"), text("one/loss.csv"));
    // Only the first rank prints and writes.
    const std::string told = said(), row = "training vehicles  ";
    EXPECT_NE(told.find(row), std::string::npos) << told;
    EXPECT_EQ(told.find(row, told.find(row) + 1), std::string::npos) << told;
  }
}

TEST_F(Ranks, ThePlateauIsTheSameOnAnyNumberOfProcesses) {
  learn_on_one_and_two(3, " --detector lidar --until-plateau 2 --validate-every 1 --fp-top-k 20", "plateau");
}

TEST_F(Ranks, ThePortfolioIsTheSameOnAnyNumberOfProcesses) {
  const auto report = learn_on_one_and_two(16, " --attack auto --detector lidar --validate-every 5", "auto");
  EXPECT_EQ(report.at("candidates").size(), 4u);
}

TEST_F(Ranks, TheBlackBoxIsTheSameOnAnyNumberOfProcesses) {
  const char* few = " --attack black-box --detector lidar --parts size --free --queries 110";
  EXPECT_GE(learn_on_one_and_two(0, few, "black_box").at("generations"), 1);
}

TEST_F(Ranks, ADeadRankEndsTheRunAndTheCheckpointGoesOn) {
  const auto checkpoint = folder_ / "run/checkpoint.json";
  std::atomic<bool> ended = false;
  std::thread killer([&] {
    while (!ended && !fs::exists(checkpoint)) std::this_thread::sleep_for(std::chrono::milliseconds(50));
    // The newest process is a rank; the brackets keep the pattern from matching this shell.
    shell("pkill -9 -n -f '[m]irage attack.*" + at("run") + "'");
  });
  const int code = std::system((on_ranks(2, attack("run", 5000)) + " > /dev/null 2>&1").c_str());
  ended = true;
  killer.join();
  EXPECT_NE(code, 0);
  ASSERT_TRUE(fs::exists(checkpoint));
  const int reached = read_json(checkpoint).at("iteration");
  EXPECT_GE(reached, 10);
  EXPECT_LT(reached, 5000);
  ASSERT_EQ(mirage(attack("run", reached + 1)), 0) << said();
  EXPECT_EQ(json("run/result.json").at("iterations"), reached + 1);
}

TEST_F(Ranks, StepsOfAReproductionAreTakenSideBySide) {
  ASSERT_EQ(mirage(reproduce("one")), 0) << said();
  // A step that cannot run fails on every process, and no process waits for it.
  write_file(folder_ / "two/runs/kitti64-fusion-lidar", "no folder");
  ASSERT_EQ(mirage_on(2, reproduce("two")), 1) << said();
  EXPECT_THAT(said(), HasSubstr("steps failed; runs/kitti64-fusion-lidar: "));
  const auto steps = json("two/result.json").at("steps");
  EXPECT_EQ(steps.at("runs/kitti64-fusion-lidar").at("status"), "failed");
  EXPECT_THAT(steps.at("evaluations/kitti64-fusion-lidar").at("error"),
              HasSubstr("needs runs/kitti64-fusion-lidar"));
  EXPECT_EQ(steps.at("evaluations/kitti64-lidar-lidar").at("status"), "done");
  const auto read = [&](const fs::path& file) { return read_file(folder_ / "two" / file); };
  const std::string mesh = "runs/kitti64-lidar-lidar/adversary.glb";
  const auto made = fs::last_write_time(folder_ / "two" / mesh);
  // Run again: finished steps are kept, and the others are made as on one process.
  fs::remove(folder_ / "two/runs/kitti64-fusion-lidar");
  ASSERT_EQ(mirage_on(2, reproduce("two")), 0) << said();
  EXPECT_EQ(fs::last_write_time(folder_ / "two" / mesh), made);
  for (const char* run : {"kitti64-lidar-lidar", "kitti64-fusion-lidar"})
    EXPECT_EQ(read(fs::path("runs") / run / "adversary.glb"),
              read_file(folder_ / "one/runs" / run / "adversary.glb"));
  EXPECT_EQ(json("two/result.json").at("arms"), json("one/result.json").at("arms"));
}

TEST_F(Ranks, AnEvaluationIsTheSameOnAnyNumberOfProcessesAndGoesOn) {
  ASSERT_EQ(mirage(attack("run", 2) + " --detector lidar"), 0);
  const std::string judge = "evaluate --hosts all --random-meshes 1 --run " + at("run");
  const nlohmann::json alone = same_on_one_and_three(judge, "attacked");
  // One answer for each mesh on each host.
  EXPECT_EQ(kept("attacked"), alone.at("hosts").get<std::size_t>() * alone.at("arms").size());
  // They share their work only through the cache.
  EXPECT_EQ(mirage_on(2, judge + " --out " + at("none")), 2);
  EXPECT_THAT(said(), HasSubstr("set MIRAGE_CACHE"));
}

TEST_F(Ranks, AComparisonIsTheSameOnAnyNumberOfProcessesAndGoesOn) {
  const nlohmann::json alone =
      same_on_one_and_three("compare --detectors lidar --defense none ceiling:2 --data " + frames_ +
                                " --mesh " MIRAGE_SOURCE "/scenes/objects/ellipsoid.glb",
                            "attacked");
  EXPECT_EQ(kept("attacked"), 2 * alone.at("compare").at("hosts").get<std::size_t>());
}

TEST_F(Ranks, ADetectionIsTheSameOnAnyNumberOfProcessesAndGoesOn) {
  same_on_one_and_three("detect --detector lidar --kitti " + at("kitti") + " --data " + frames_, "found");
  EXPECT_EQ(kept("found"), 3u);
  EXPECT_EQ(text("three/detections.json"), text("alone/detections.json"));
  EXPECT_EQ(text("again/detections.json"), text("alone/detections.json"));
  for (const char* frame : {"000000", "000001", "000002"})
    EXPECT_TRUE(exists(std::string("kitti/") + frame + ".txt")) << frame;
}

TEST_F(Ranks, AnAuditIsTheSameOnAnyNumberOfProcessesAndGoesOn) {
  const nlohmann::json alone = same_on_one_and_three("audit --detector lidar --data " + frames_, "audited");
  EXPECT_EQ(kept("audited"), 3 * (1 + alone.at("audit").size()));  // as recorded, and with each change
}

TEST_F(Ranks, ACertificateIsTheSameOnAnyNumberOfProcessesAndGoesOn) {
  same_on_one_and_three(
      "certify --detector lidar --sizes 0.4 --objects 1 --lattice --whole-lattice --step 10 "
      "--farthest 20 --mesh " MIRAGE_SOURCE "/scenes/objects/ellipsoid.glb --data " +
          frames_,
      "certified");
}

TEST_F(Ranks, AScoreIsTheSameOnAnyNumberOfProcessesAndGoesOn) {
  same_on_one_and_three("score --detector lidar --frames 2 --learn-frames 2 --sizes 0.4 --iterations 2",
                        "attacked");
}

TEST_F(Ranks, FitsAreTheSameOnAnyNumberOfProcessesAndGoOn) {
  const auto fit = [&](const std::string& out) {
    return "fit --threads 1 --data " + frames_ + " --out " + at(out);
  };
  ASSERT_EQ(mirage(fit("one")), 0) << said();
  ASSERT_EQ(mirage_on(2, fit("two")), 0) << said();
  const nlohmann::json alone = result("one"), vehicles = without_times(json("one/vehicles.json"));
  EXPECT_EQ(result("two"), alone);
  EXPECT_EQ(without_times(json("two/vehicles.json")), vehicles);
  std::vector<fs::path> meshes;
  for (const auto& entry : fs::directory_iterator(folder_ / "one/meshes")) {
    meshes.push_back(entry.path().filename());
    EXPECT_EQ(text("two/meshes" / meshes.back()), read_file(entry.path())) << entry.path();
  }
  ASSERT_FALSE(meshes.empty());
  // Existing files are read again, with their times; missing ones are made.
  const std::string kept = text("two/frames/000000.json");
  fs::remove(folder_ / "two/frames/000001.json");
  for (const fs::path& mesh : meshes)
    if (mesh.string().starts_with("000002")) fs::remove(folder_ / "two/meshes" / mesh);
  ASSERT_EQ(mirage(fit("two")), 0) << said();
  EXPECT_EQ(text("two/frames/000000.json"), kept);
  EXPECT_TRUE(exists("two/frames/000001.json"));
  for (const fs::path& mesh : meshes) EXPECT_TRUE(exists("two/meshes" / mesh)) << mesh;
  EXPECT_EQ(result("two"), alone);
  EXPECT_EQ(without_times(json("two/vehicles.json")), vehicles);
}

TEST_F(Ranks, FramesAreGeneratedSideBySideAndOtherCommandsRunInOneProcess) {
  ASSERT_EQ(mirage_on(2, "generate --threads 1 --frames 3 --seed 5 --out " + at("two")), 0) << said();
  for (const auto& entry : fs::recursive_directory_iterator(fs::path(frames_) / "training"))
    if (entry.is_regular_file()) {
      const fs::path twin = folder_ / "two" / fs::relative(entry.path(), frames_);
      EXPECT_EQ(read_file(twin), read_file(entry.path())) << twin;
    }
  const nlohmann::json alone = read_json(fs::path(frames_) / "result.json"), both = json("two/result.json");
  for (const char* count : {"frames", "cars", "others", "points"})
    EXPECT_EQ(both.at(count), alone.at(count)) << count;
  // Commands that share nothing run in one process.
  EXPECT_EQ(mirage_on(2, "demo --out " + at("demo")), 2);
  EXPECT_THAT(said(), HasSubstr("start it without mpirun"));
}

}  // namespace
}  // namespace mirage
