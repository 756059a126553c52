// A detector in its own process: its inputs, its answers, and every way to lose it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <cstdlib>
#include <thread>

#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "detection/process_detector.h"
#include "support/files.h"
#include "support/heard.h"

namespace mirage {
namespace {

using test::error_text;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class ProcessTest : public testing::Test {
 protected:
  ProcessTest() : image_(8, 4, 3, 0.25f) {
    points_ = {LidarPoint{1.5f, 2, 3, 0.5f}, LidarPoint{4, 5, 6, 0.1f}};
    calibration_.camera.width = 8, calibration_.camera.height = 4;
    calibration_.camera.fx = calibration_.camera.fy = 5;
  }

  std::unique_ptr<Detector> start(const std::string& what, const ProcessLimits& limits = {60, 60}) {
    DetectorOptions options;
    options.threads = 1;
    options.detector =
        "exec:/usr/bin/python3 -B '" MIRAGE_SOURCE "/tests/detection/process/detector.py' " + what;
    return start_program(options, limits);
  }
  SensorView view() { return {&image_, points_, &calibration_}; }
  std::string once(const std::string& what) { return what + " " + (folder_ / "mark").string(); }

  test::TemporaryFolder folder_;
  ImageF image_;
  Sweep points_;
  Calibration calibration_;
};

TEST_F(ProcessTest, ItIsToldAFrameAndAnswers) {
  const auto detector = start("works");
  EXPECT_THAT(detector->name(), HasSubstr("exec:"));
  EXPECT_TRUE(detector->capabilities().finds_heights);
  EXPECT_TRUE(detector->capabilities().has_gradients);
  EXPECT_EQ(detector->region(), (std::array<double, 4>{0, 50, -20, 20}));
  const auto found = detector->forward(view(), 0.1, true);
  ASSERT_EQ(found.size(), 2u);  // the third is below the threshold
  EXPECT_FLOAT_EQ(static_cast<float>(found[0].logit), 2 * 0.25f + 1.5f);
  EXPECT_FLOAT_EQ(static_cast<float>(found[0].box.bev.yaw), 0.1f);
  EXPECT_DOUBLE_EQ(found[0].box.bottom, -1.75);
  EXPECT_DOUBLE_EQ(found[0].box.height, 1.5);
  const SensorGradient gradient = detector->backward(std::vector<double>{3, 1});
  EXPECT_EQ(gradient.image.width, 8);
  EXPECT_FLOAT_EQ(gradient.image.data[0], 6);
  EXPECT_EQ(std::count(gradient.image.data.begin(), gradient.image.data.end(), 0.f), 8 * 4 * 3 - 1);
  ASSERT_EQ(gradient.points.size(), 2u);
  EXPECT_FLOAT_EQ(gradient.points[0][0], 3);
  EXPECT_FLOAT_EQ(gradient.points[1][0], 0);
}

TEST_F(ProcessTest, LargerAndEmptyFramesFollow) {
  const auto detector = start("works");
  for (const int width : {8, 2000, 30}) {
    image_ = ImageF(width, 1500, 3, 0.5f);
    points_.assign(width == 2000 ? 200000 : 1, LidarPoint{1, 2, 3, 0.5f});
    ASSERT_EQ(detector->forward(view(), 0.1, true).size(), 2u);
    EXPECT_FLOAT_EQ(detector->backward(std::vector<double>{1, 0}).image.data[0], 2);
  }
  SensorView blind = view();
  blind.image = nullptr;
  EXPECT_FLOAT_EQ(static_cast<float>(detector->forward(blind, 0.1, true)[0].logit), 1);
  EXPECT_TRUE(detector->backward(std::vector<double>{1, 0}).image.empty());
}

TEST_F(ProcessTest, EightBitPicturesCarryTheCurvesSlope) {
  const auto detector = start("srgb8");
  image_.data[0] = linear_level(100);
  EXPECT_FLOAT_EQ(static_cast<float>(detector->forward(view(), 1e-9, true)[0].logit), 2 * 100 + 1.5f);
  const float slope = detector->backward(std::vector<double>{1, 0}).image.data[0];
  // From the middle of a level ten below to that of one ten above: rounding adds no slope.
  image_.data[0] = linear_level(110);
  const double above = detector->forward(view(), 1e-9, true)[0].logit;
  image_.data[0] = linear_level(90);
  const double below = detector->forward(view(), 1e-9, true)[0].logit;
  EXPECT_NEAR(slope, (above - below) / (linear_level(110) - linear_level(90)), 0.01 * slope);
}

TEST_F(ProcessTest, ClassesAndVelocitiesTravel) {
  const auto nine = start("nine")->forward(view(), 0.1, false);
  ASSERT_TRUE(nine[0].velocity);
  EXPECT_EQ(*nine[0].velocity, Vec3d(3, 1, 0));
  const auto classes = start("classes");
  EXPECT_EQ(classes->capabilities().types, (std::vector<std::string>{"Pedestrian", "Car"}));
  const auto found = classes->forward(view(), 0.1, true);
  ASSERT_EQ(found.size(), 3u);
  EXPECT_EQ(found[0].type, 1);
  EXPECT_EQ(found[1].type, 0);
}

TEST_F(ProcessTest, ATrackerReadsDetectionsAndAnswersIdentities) {
  const auto tracker = start("tracker");
  const Capabilities can = tracker->capabilities();
  EXPECT_TRUE(can.remembers);
  EXPECT_FALSE(can.reads_image || can.reads_points);
  EXPECT_EQ(can.reads, std::vector<std::string>{"detections"});
  const std::vector<float> rows = {9, 1, -1, 4, 2, 1.5f, 0.1f, 0.9f, 20, -1, -1, 4, 2, 1.5f, 0, 0.4f};
  SensorData detections;
  detections.kind = SensorData::Kind::other;
  detections.name = "detections";
  detections.values = rows;
  detections.shape = {2, 8, 0};
  SensorView told;
  told.calibration = &calibration_;
  told.others = {detections};
  for (const bool continues : {false, true, false}) {
    told.continues = continues;
    const auto found = tracker->forward(told, 0, false);
    ASSERT_EQ(found.size(), 2u);
    EXPECT_EQ(found[0].identity, continues ? 20 : 10);
    EXPECT_EQ(found[1].identity, found[0].identity + 1);
    EXPECT_FLOAT_EQ(static_cast<float>(found[1].box.bev.x), 20);
    EXPECT_DOUBLE_EQ(found[1].box.height, 1.5);
  }
  EXPECT_THAT(error_text<Failure>([&] { start("few-identities")->forward(told, 0, false); }),
              HasSubstr("identities: have shape [1] for 2 boxes"));
}

TEST_F(ProcessTest, OtherSensorsTravelByName) {
  const auto detector = start("others");
  ImageF left(6, 3, 3, 0.5f);
  SensorData camera, lidar, radar;
  camera.name = "LEFT", camera.image = &left;
  lidar.kind = SensorData::Kind::lidar, lidar.name = "rear", lidar.points = points_;
  const std::vector<float> powers = {0, 1, 2, 3, 4, 11};
  radar.kind = SensorData::Kind::other, radar.name = "radar", radar.values = powers, radar.shape = {1, 2, 3};
  SensorView all = view();
  all.others = {camera, lidar, radar};
  Frame frame;
  frame.id = "000007";
  frame.moment = Moment{"drive", 7, 0.75, Transform::Identity()};
  all.frame = &frame;
  // Three times the first value of LEFT, the second point's y of rear, radar's last value, the frame's number
  // and its time.
  EXPECT_FLOAT_EQ(static_cast<float>(detector->forward(all, 0.1, true)[0].logit),
                  3 * 0.5f + 5 + 11 + 7 + 0.75f);
  const SensorGradient gradient = detector->backward(std::vector<double>{2, 0});
  ASSERT_EQ(gradient.others.size(), 3u);
  EXPECT_FLOAT_EQ(gradient.others.at("LEFT")[0], 6);
  EXPECT_FLOAT_EQ(gradient.others.at("rear")[5], 2);
  EXPECT_EQ(gradient.others.at("radar"), (std::vector<float>{0, 0, 0, 0, 0, 2}));
  EXPECT_EQ(gradient.image.data[0], 0);
}

TEST_F(ProcessTest, ALocalOneIsToldOfTheFrameWithoutTheObject) {
  const auto whole = start("works"), detector = start("local");
  EXPECT_NE(whole->capabilities().why_whole, "");
  EXPECT_EQ(detector->capabilities().why_whole, "");
  const ImageF clean_image = image_;
  Sweep clean_points;
  for (int i = 0; i < 100; ++i) clean_points.push_back({static_cast<float>(i), 0, 0, 0});
  points_ = clean_points;
  points_.erase(points_.begin() + 7);
  points_.push_back({0.5f, 1, 1, 1});
  const auto ask = [&](const UnchangedInput* clean) {
    SensorView now = view();
    now.clean = clean;
    std::vector<double> logits;
    for (const Detection& found : detector->forward(now, 0, false)) logits.push_back(found.logit);
    return logits;
  };
  const double sum = 99 * 100 / 2 - 7 + 0.5;
  const UnchangedInput clean{&clean_image, clean_points, 0xfedcba9876543210, {1, 0, 6, 3}};
  EXPECT_EQ(ask(nullptr), (std::vector<double>{sum, 100, 0, 0}));
  EXPECT_EQ(ask(&clean), (std::vector<double>{sum, 101, 6, 3}));
  EXPECT_EQ(ask(&clean), (std::vector<double>{sum, 1, 6, 3}));  // the rest was kept
}

TEST_F(ProcessTest, OneThatIsLostIsStartedAgain) {
  for (const char* what : {"dies", "hangs", "garbage"}) {
    std::filesystem::remove(folder_ / "mark");
    const auto detector = start(once(what), {60, 3});
    EXPECT_EQ(detector->forward(view(), 0.1, true).size(), 2u) << what;
    EXPECT_FLOAT_EQ(detector->backward(std::vector<double>{1, 0}).points[0][0], 1) << what;
  }
}

TEST_F(ProcessTest, OneThatDiesAtTheGradientIsGivenTheFrameAnew) {
  const auto detector = start(once("dies-back"));
  ASSERT_EQ(detector->forward(view(), 0.1, true).size(), 2u);
  const SensorGradient gradient = detector->backward(std::vector<double>{2, 0});
  EXPECT_FLOAT_EQ(gradient.points[0][0], 2);
  EXPECT_FLOAT_EQ(gradient.image.data[0], 4);
}

TEST_F(ProcessTest, OneThatRemembersIsNotStartedAgainInTheMiddleOfASequence) {
  SensorView first = view(), second = view();
  second.continues = true;
  {
    const auto detector = start(once("dies-first"));
    EXPECT_TRUE(detector->capabilities().remembers);
    EXPECT_EQ(detector->forward(first, 0.1, true).size(), 2u);
    EXPECT_EQ(detector->forward(second, 0.1, true).size(), 2u);
  }
  std::filesystem::remove(folder_ / "mark");
  const auto detector = start(once("dies-second"));
  EXPECT_EQ(detector->forward(first, 0.1, false).size(), 2u);
  for (const char* how : {"ended unexpectedly", "was started anew"})
    EXPECT_THAT(error_text<Failure>([&] { detector->forward(second, 0.1, false); }),
                AllOf(HasSubstr(how), HasSubstr("in the middle of a sequence"), Not(HasSubstr("\n"))));
  EXPECT_EQ(detector->forward(first, 0.1, false).size(), 2u);  // a new sequence
}

TEST_F(ProcessTest, OneThatIsAlwaysLostIsGivenUpInALine) {
  const auto text = [&](const char* what, double seconds) {
    const auto detector = start(what, {60, seconds});
    return error_text<Failure>([&] { detector->forward(view(), 0.1, false); });
  };
  EXPECT_THAT(text("dies", 60),
              AllOf(HasSubstr("ended unexpectedly, 3 times at one frame"), Not(HasSubstr("\n"))));
  EXPECT_THAT(text("hangs", 0.5), HasSubstr("gave no answer in 0.5 s, 3 times"));
  EXPECT_THAT(text("garbage", 60), AllOf(HasSubstr("gave a malformed answer ('"), Not(HasSubstr("\n"))));
}

TEST_F(ProcessTest, WhatItDoesWrongIsALine) {
  const auto failure = [&](const char* what) {
    const auto detector = start(what);
    return error_text<Failure>([&] {
      const auto found = detector->forward(view(), 0.1, true);
      detector->backward(std::vector<double>(found.size(), 1));
    });
  };
  EXPECT_THAT(failure("raises"), AllOf(HasSubstr("RuntimeError: no such"), Not(HasSubstr("\n"))));
  EXPECT_THAT(failure("not-finite"), HasSubstr("not finite"));
  EXPECT_THAT(failure("unnamed-classes"), HasSubstr("are not named"));
  EXPECT_THAT(failure("nan-back"), HasSubstr("d_image that are not finite"));
  const auto without = start("no-gradient");
  EXPECT_EQ(without->forward(view(), 0.1, false).size(), 2u);
  EXPECT_THAT(error_text<InputError>([&] { without->forward(view(), 0.1, true); }),
              HasSubstr("gives no gradient"));
}

TEST_F(ProcessTest, WhatItPrintsIsNoAnswer) {
  EXPECT_EQ(start("prints")->forward(view(), 0.1, false).size(), 2u);
  EXPECT_EQ(start("talks")->forward(view(), 0.1, false).size(), 2u);
}

TEST_F(ProcessTest, ACommandThatDoesNotServeIsALine) {
  const auto text = [&](const std::string& command, double seconds = 60) {
    DetectorOptions options;
    options.detector = "exec:" + command;
    return error_text<InputError>([&] { start_program(options, {seconds, 60}); });
  };
  EXPECT_THAT(text(""), HasSubstr("is not a command"));
  EXPECT_THAT(text("python3 a.py | tee log"), HasSubstr("is not a command"));
  EXPECT_THAT(text("no-such-program a.py"), HasSubstr("not on PATH: no-such-program"));
  EXPECT_THAT(text("/bin/false"), HasSubstr("ended before it served (exit code 1)"));
  EXPECT_THAT(text("/bin/sleep 60", 0.3), HasSubstr("gave no answer in 0.3 s"));
  EXPECT_THAT(text("/bin/sh -c 'read a; echo \"{\\\"id\\\":1,\\\"ok\\\":true,\\\"protocol\\\":7}\"; read b'"),
              HasSubstr("protocol is 7, not 1"));
  EXPECT_THAT(error_text<InputError>([&] { start("early"); }),
              HasSubstr("ended before it served (exit code 1)"));
}

// It does not wait and does not restart the process: the next answer would be the same.
TEST_F(ProcessTest, AnAnswerAgainstTheProtocolIsALineAtOnce) {
  const auto run = [&](const std::string& hello, const std::string& detections) {
    write_file(folder_ / "answers.sh",
               "read a\necho '" + hello + "'\nread b\necho '" + detections + "'\nread c\n");
    DetectorOptions options;
    options.detector = "exec:/bin/sh " + (folder_ / "answers.sh").string();
    start_program(options, {60, 60})->forward(view(), 0.1, false);
  };
  const auto is_line = [](const std::string& answer, const std::string& problem) {
    return AllOf(HasSubstr("answers.sh"), HasSubstr("gave a malformed answer ('" + answer + "')"),
                 HasSubstr(problem), HasSubstr("answer with the job's \"id\""), Not(HasSubstr("3 times")),
                 Not(HasSubstr("\n")));
  };
  const std::string good = R"({"id":1,"ok":true,"protocol":1})", ok = "whose ok is neither true nor false";
  for (const auto& [id, value, problem] : {std::tuple<std::string, std::string, std::string>{"1", "1", ok},
                                           {"1", "\"true\"", ok},
                                           {"1", "null", ok},
                                           {"1.0", "true", "whose id is not 1, the job's"},
                                           {"\"1\"", "true", "whose id is not 1, the job's"},
                                           {"0", "true", "whose id is not 1, the job's"}}) {
    const std::string answer = "{\"id\":" + id + ",\"ok\":" + value + "}";
    EXPECT_THAT(error_text<InputError>([&] { run(answer, good); }), is_line(answer, problem));
  }
  EXPECT_THAT(error_text<Failure>([&] { run(good, R"({"id":2,"ok":1})"); }),
              is_line(R"({"id":2,"ok":1})", ok));
  EXPECT_THAT(error_text<Failure>([&] { run(good, R"({"id":1,"ok":true})"); }),
              is_line(R"({"id":1,"ok":true})", "whose id is not 2, the job's"));
}

TEST(Description, WhatIsOfAnotherKindIsALine) {
  const auto text = [](const char* key, const nlohmann::json& value) {
    return error_text<InputError>([&] { read_external_description({{key, value}}, "exec:my_detector"); });
  };
  for (const char* key : {"gradient", "heights", "remembers", "local"}) {
    EXPECT_THAT(text(key, 1), AllOf(HasSubstr("exec:my_detector"),
                                    HasSubstr(std::string(key) + " is 1; use true or false")));
    EXPECT_THAT(text(key, "true"), HasSubstr(std::string(key) + " is \"true\"; use true or false"));
  }
  EXPECT_THAT(text("finds", {"picture"}), HasSubstr("finds is [\"picture\"]; use boxes or picture"));
  EXPECT_THAT(text("pictures", 8), HasSubstr("pictures is 8; use linear or srgb8"));
  EXPECT_FALSE(read_external_description({{"remembers", nullptr}}, "exec:my_detector").can.remembers);
}

/// Arrays outside the shared memory are refused.
TEST_F(ProcessTest, ArraysOutsideOfTheirRoomAreRefused) {
  const auto text = [&](const std::string& boxes, const std::string& logits) {
    write_file(folder_ / "answers.sh",
               "read a\necho '{\"id\":1,\"ok\":true,\"protocol\":1}'\nread b\n"
               "at=$(echo \"$b\" | sed 's/.*\"answer_at\":\\([0-9]*\\).*/\\1/')\n"
               "echo \"{\\\"id\\\":2,\\\"ok\\\":true,\\\"boxes\\\":" +
                   boxes + ",\\\"logits\\\":" + logits + "}\"\nread c\n");
    DetectorOptions options;
    options.detector = "exec:/bin/sh " + (folder_ / "answers.sh").string();
    const auto detector = start_program(options, {60, 60});
    return error_text<Failure>([&] { detector->forward(view(), 0.1, false); });
  };
  const std::string logits = "{\\\"at\\\":$at,\\\"shape\\\":[1]}";
  const auto boxes = [](const std::string& at, const std::string& shape) {
    return "{\\\"at\\\":" + at + ",\\\"shape\\\":" + shape + "}";
  };
  EXPECT_THAT(text(boxes("0", "[1,5]"), logits), HasSubstr("outside of its room (at 0)"));
  EXPECT_THAT(text(boxes("-8", "[1,5]"), logits), HasSubstr("boxes at -8"));
  EXPECT_THAT(text(boxes("99999999999", "[1,5]"), logits), HasSubstr("outside of its room"));
  EXPECT_THAT(text(boxes("$((at + 2))", "[1,5]"), logits), HasSubstr("outside of its room"));
  EXPECT_THAT(text(boxes("$at", "[4294967296,4294967296]"), logits), HasSubstr("larger than the memory"));
  EXPECT_THAT(text(boxes("$at", "[5]"), logits), HasSubstr("of shape [5]"));
  EXPECT_THAT(text(boxes("$at", "[1,6]"), logits), HasSubstr("boxes of shape 1 × 6 with 1 logits"));
  EXPECT_THAT(text(boxes("$at", "[2,5]"), logits), HasSubstr("boxes of shape 2 × 5 with 1 logits"));
  EXPECT_THAT(text("5", logits), HasSubstr("boxes missing"));
}

TEST_F(ProcessTest, SeveralRunAtOnce) {
  std::vector<std::unique_ptr<Detector>> detectors;
  for (int i = 0; i < 3; ++i) detectors.push_back(start("works"));
  std::vector<double> logits(detectors.size());
  std::vector<std::thread> threads;
  for (std::size_t i = 0; i < detectors.size(); ++i)
    threads.emplace_back([&, i] {
      ImageF own(8, 4, 3, static_cast<float>(i));
      for (int k = 0; k < 20; ++k)
        logits[i] = detectors[i]->forward({&own, points_, &calibration_}, 0.1, false)[0].logit;
    });
  for (std::thread& thread : threads) thread.join();
  for (std::size_t i = 0; i < logits.size(); ++i)
    EXPECT_FLOAT_EQ(static_cast<float>(logits[i]), 2.f * static_cast<float>(i) + 1.5f);
}

TEST_F(ProcessTest, TheContentIsTheCommandsAndItsFiles) {
  const std::string file = folder_ / "a.py", command = "exec:python3 '" + file + "' --size 3";
  write_file(file, "1");
  const std::string before = program_hash(command);
  EXPECT_NE(program_hash("exec:python3 '" + file + "' --size 4"), before);
  write_file(folder_ / "b.py", "1");  // its path does not matter
  EXPECT_EQ(program_hash("exec:python3 '" + (folder_ / "b.py").string() + "' --size 3"), before);
  write_file(file, "2");
  EXPECT_NE(program_hash(command), before);
}

TEST_F(ProcessTest, AFileBehindAnEqualsSignCounts) {
  const std::string file = folder_ / "a.pt", moved = folder_ / "b.pt";
  const auto content = [](const std::string& word) { return program_hash("exec:python3 f.py " + word); };
  for (const char* start : {"--weights=", "WEIGHTS=", "--set=weights="}) {
    write_file(file, "1");
    write_file(moved, "1");
    const std::string before = content(start + file);
    EXPECT_EQ(content(start + moved), before) << start;
    EXPECT_NE(content("--other=" + file), before) << start;
    write_file(file, "2");
    EXPECT_NE(content(start + file), before) << start;
  }
  EXPECT_NE(content(std::string(5000, 'a')), content(std::string(5000, 'b')));  // too long for a file name
}

TEST_F(ProcessTest, WhatDoesNotCountIsSaidOnce) {
  const test::Heard heard;
  const std::string folder = folder_.path().string(),
                    command = "exec:/usr/bin/python3 -m my_detector --model=" + folder;
  const std::string before = program_hash(command);
  write_file(folder_ / "weights.pt", "1");
  EXPECT_EQ(program_hash(command), before);
  EXPECT_EQ(heard.warnings(), 1);
  EXPECT_THAT(heard.text(), HasSubstr("what my_detector, " + folder + " holds does not count"));
}

TEST_F(ProcessTest, TheExampleInC) {
  const std::string program = folder_ / "example";
  const std::string build = "cc -std=c11 -D_GNU_SOURCE -Wall -Wextra -Wpedantic -Werror -O1 '" MIRAGE_SOURCE
                            "/plugins/process/example.c' -o '" +
                            program + "'";
  ASSERT_EQ(std::system(build.c_str()), 0);
  DetectorOptions options;
  options.detector = "exec:" + program;
  const auto detector = start_program(options);
  points_.clear();
  for (int i = 0; i < 6; ++i) points_.push_back({10, 1, 0, 0.1f * static_cast<float>(i)});
  points_.push_back({2, 1, 0, 9});  // too near to count
  for (const char* id : {"000000", "a}b", "{\"camera\":{", "c\\"}) {
    Frame frame;
    frame.id = id;
    SensorView with_id = view();
    with_id.frame = &frame;
    const auto found = detector->forward(with_id, 0.1, true);
    ASSERT_EQ(found.size(), 1u);
    EXPECT_NEAR(found[0].logit, 2.5, 1e-5);
    EXPECT_EQ(found[0].box.bev.x, 10);
    const SensorGradient gradient = detector->backward(std::vector<double>{3});
    EXPECT_NEAR(gradient.points[0][3], 3 * 10 / 6., 1e-5);
    EXPECT_EQ(gradient.points[6][3], 0);
    EXPECT_EQ(gradient.image.width, 8);
  }
  points_.clear();
  EXPECT_TRUE(detector->forward(view(), 0.1, false).empty());
}

}  // namespace
}  // namespace mirage
