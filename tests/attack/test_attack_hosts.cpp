// Hosts from a detector's own boxes: a run resumes only with the same detector and frames.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "attack/attack_hosts.h"
#include "attack/tiny_world.h"
#include "base/error.h"
#include "support/files.h"

namespace mirage {
namespace {

using testing::AllOf;
using testing::HasSubstr;

TEST(LabelByDetections, LabelsOfAnotherDetectorOrOfOtherFramesAreNotTaken) {
  test::TemporaryFolder folder;
  test::write_tiny_data(folder / "data", 2, true);
  std::filesystem::remove_all(folder / "data/training/label_2");
  const DetectorPool detectors = test::one_of<test::StandInDetector>();
  AttackSettings settings = test::tiny_attack();
  settings.data = folder / "data";
  settings.out = folder / "run";
  settings.quiet = true;
  const auto labelled = label_by_detections(settings, detectors);
  const auto file = labelled / "label_2/000000.txt";
  const std::string labels = read_file(file);
  write_file(file, labels + labels);  // another detector would give other labels
  EXPECT_EQ(label_by_detections(settings, detectors), labelled);
  EXPECT_EQ(read_file(file), labels + labels);
  const auto refused = [&](const auto& change) {
    AttackSettings other = settings;
    change(other);
    EXPECT_THAT(test::error_text<InputError>([&] { label_by_detections(other, detectors); }),
                AllOf(HasSubstr("labels.json"), HasSubstr("give another --out")));
  };
  refused([](AttackSettings& s) { s.weights_hash = "another"; });
  refused([](AttackSettings& s) { s.detector.defense = "jpeg:50"; });
  refused([](AttackSettings& s) { s.detector.precision = kDouble; });
  refused([](AttackSettings& s) { s.detector.matching = MatchBy::centre; });
  refused([](AttackSettings& s) { s.classes = "Car,Van"; });
  const auto sweep = folder / "data/training/velodyne/000000.bin";
  const std::string points = read_file(sweep);
  constexpr std::size_t kPoint = 4 * sizeof(float);
  write_file(sweep, points + points.substr(0, kPoint));
  refused([](AttackSettings&) {});
  write_file(sweep, points);
  EXPECT_EQ(label_by_detections(settings, detectors), labelled);
}

}  // namespace
}  // namespace mirage
