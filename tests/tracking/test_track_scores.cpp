// CLEAR MOT and HOTA on hand-made cases, and on published detections if available: MIRAGE_DRIVES names a
// folder with label_02, calib, oxts and pointrcnn for the sequences 0000 and 0003.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <map>
#include <sstream>

#include "base/error.h"
#include "base/json_fields.h"
#include "base/sizes.h"
#include "tracking/tracker.h"

namespace mirage {
namespace {

/// One true object, 7, and for each frame the track that lies exactly on it (0: none).
std::vector<TrackFrame> on_one_truth(const std::vector<int>& tracks, double similarity = 1) {
  std::vector<TrackFrame> frames;
  for (const int track : tracks) {
    TrackFrame frame{{7}, {}, Eigen::MatrixXd(1, 0)};
    if (track > 0) {
      frame.tracks = {track};
      frame.similarity = Eigen::MatrixXd::Constant(1, 1, similarity);
    }
    frames.push_back(frame);
  }
  return frames;
}

TEST(TrackScores, OfAPerfectTrack) {
  const TrackScores s = score_tracks(on_one_truth({1, 1, 1, 1}));
  EXPECT_EQ(s.matches, 4);
  EXPECT_DOUBLE_EQ(s.mota, 1);
  EXPECT_DOUBLE_EQ(s.motp, 1);
  EXPECT_NEAR(s.hota, 1, 1e-12);
  EXPECT_EQ(s.mostly_tracked, 1);
}

TEST(TrackScores, OfASwitch) {
  const TrackScores s = score_tracks(on_one_truth({1, 1, 2, 2}));
  EXPECT_EQ(s.switches, 1);
  EXPECT_EQ(s.fragments, 0);
  EXPECT_DOUBLE_EQ(s.mota, 0.75);
  EXPECT_NEAR(s.deta, 1, 1e-12);
  EXPECT_NEAR(s.assa, 0.5, 1e-12);  // each match: two frames together, two of the truth's without
  EXPECT_NEAR(s.hota, std::sqrt(0.5), 1e-12);
}

TEST(TrackScores, OfAGap) {
  const TrackScores s = score_tracks(on_one_truth({1, 1, 0, 1}));
  EXPECT_EQ(s.switches, 0);
  EXPECT_EQ(s.fragments, 1);
  EXPECT_EQ(s.misses, 1);
  EXPECT_DOUBLE_EQ(s.mota, 0.75);
  EXPECT_NEAR(s.deta, 0.75, 1e-12);
  EXPECT_NEAR(s.assa, 0.75, 1e-12);
  EXPECT_NEAR(s.hota, 0.75, 1e-12);
  EXPECT_EQ(s.mostly_tracked, 0);
}

TEST(TrackScores, ASwitchAfterAGapIsBoth) {
  const TrackScores s = score_tracks(on_one_truth({1, 0, 2, 2}));
  EXPECT_EQ(s.switches, 1);
  EXPECT_EQ(s.fragments, 1);
  EXPECT_DOUBLE_EQ(s.mota, 0.5);
}

TEST(TrackScores, OfAFalseAlarm) {
  std::vector<TrackFrame> frames = on_one_truth({1, 1, 1, 1});
  frames[2].tracks.push_back(5);
  frames[2].similarity = Eigen::MatrixXd(1, 2);
  frames[2].similarity << 1, 0;
  const TrackScores s = score_tracks(frames);
  EXPECT_EQ(s.false_positives, 1);
  EXPECT_DOUBLE_EQ(s.mota, 0.75);
  EXPECT_NEAR(s.deta, 0.8, 1e-12);
  EXPECT_NEAR(s.assa, 1, 1e-12);
}

TEST(TrackScores, HotaLooksAtAllThresholdsAndClearAtOne) {
  const TrackScores loose = score_tracks(on_one_truth({1, 1, 1}, 0.6));
  EXPECT_NEAR(loose.hota, 12.0 / 19, 1e-12);  // α = 0.05 … 0.60
  EXPECT_NEAR(loose.motp, 0.6, 1e-12);
  EXPECT_DOUBLE_EQ(loose.mota, 1);
  const TrackScores missed = score_tracks(on_one_truth({1, 1, 1}, 0.4));
  EXPECT_DOUBLE_EQ(missed.mota, -1);  // three misses, three false alarms
  EXPECT_EQ(missed.mostly_lost, 1);
}

// Another track overlaps more in one frame; the pair of the previous frame is kept while it still matches.
TEST(TrackScores, ClearKeepsAPairThatStillMatches) {
  std::vector<TrackFrame> frames = on_one_truth({1, 1, 1}, 0.7);
  frames[1].tracks = {1, 2};
  frames[1].similarity = Eigen::MatrixXd(1, 2);
  frames[1].similarity << 0.6, 0.9;
  const TrackScores s = score_tracks(frames);
  EXPECT_EQ(s.switches, 0);
  EXPECT_EQ(s.false_positives, 1);
  EXPECT_NEAR(s.motp, 2.0 / 3, 1e-12);
}

TEST(TrackScores, RefusesASimilarityOfAnotherSize) {
  std::vector<TrackFrame> frames = on_one_truth({1});
  frames[0].similarity = Eigen::MatrixXd(2, 1);
  EXPECT_THROW(score_tracks(frames), InputError);
}

// PointRCNN's published detections (AB3DMOT's repository) through the tracker, in `rect`: x right, y down, z
// forward. Cars count, vans are ignored; the ego motion is compensated with the oxts poses.
class PublishedDetections : public testing::Test {
 protected:
  void SetUp() override {
    const char* drives = std::getenv("MIRAGE_DRIVES");
    if (!drives) GTEST_SKIP() << "MIRAGE_DRIVES is not set";
    folder_ = drives;
  }
  struct Row {
    int frame = 0, id = 0;
    std::string type;
    Box3 box;
    double score = 0;
  };
  static Box3 box_of(double h, double w, double l, double x, double y, double z, double yaw) {
    return {{z, -x, l, w, -yaw - M_PI / 2}, -y, h};
  }
  std::vector<Row> labels(const std::string& sequence) const {
    std::vector<Row> rows;
    std::ifstream file(folder_ + "/label_02/" + sequence + ".txt");
    for (std::string line; std::getline(file, line);) {
      std::istringstream words(line);
      Row row;
      double skip = 0, n[7];
      words >> row.frame >> row.id >> row.type;
      for (int i = 0; i < 7; ++i) words >> skip;  // truncation, occlusion, alpha, box in the picture
      for (double& v : n) words >> v;
      row.box = box_of(n[0], n[1], n[2], n[3], n[4], n[5], n[6]);
      if (row.type == "Car" || row.type == "Van") rows.push_back(row);
    }
    return rows;
  }
  std::vector<Row> detections(const std::string& sequence, double least_score) const {
    std::vector<Row> rows;
    std::ifstream file(folder_ + "/pointrcnn/" + sequence + ".txt");
    for (std::string line; std::getline(file, line);) {
      std::replace(line.begin(), line.end(), ',', ' ');
      std::istringstream words(line);
      std::vector<double> n;
      for (double v = 0; words >> v;) n.push_back(v);
      if (n.size() != 15 || n[1] != 2 || n[6] < least_score) continue;
      rows.push_back(
          {static_cast<int>(n[0]), 0, "Car", box_of(n[7], n[8], n[9], n[10], n[11], n[12], n[13]), n[6]});
    }
    return rows;
  }
  /// Planar poses: x, y (m) and heading by row, from latitude, longitude and yaw.
  std::vector<Eigen::Isometry2d> poses(const std::string& sequence) const {
    std::vector<Eigen::Isometry2d> all;
    std::ifstream file(folder_ + "/oxts/" + sequence + ".txt");
    double scale = 0;
    for (std::string line; std::getline(file, line);) {
      std::istringstream words(line);
      double n[6];
      for (double& v : n) words >> v;
      if (scale == 0) scale = std::cos(n[0] * M_PI / 180) * 6378137;
      Eigen::Isometry2d pose = Eigen::Isometry2d::Identity();
      pose.rotate(n[5]);
      pose.pretranslate(
          Vec2d(scale * n[1] * M_PI / 180, scale * std::log(std::tan((90 + n[0]) * M_PI / 360))));
      all.push_back(pose);
    }
    return all;
  }
  static Box3 moved(const Box3& box, const Eigen::Isometry2d& pose) {
    const Vec2d at = pose * Vec2d(box.bev.x, box.bev.y);
    const double turn = std::atan2(pose(1, 0), pose(0, 0));
    return {{at.x(), at.y(), box.bev.length, box.bev.width, box.bev.yaw + turn}, box.bottom, box.height};
  }
  std::string folder_;
};

TEST_F(PublishedDetections, AreTrackedThroughBothDrives) {
  std::vector<TrackFrame> frames;
  int recalled = 0, cars = 0;
  for (const std::string sequence : {"0000", "0003"}) {
    const auto truth = labels(sequence), seen = detections(sequence, 3);
    const auto pose = poses(sequence);
    const int offset = sequence == "0000" ? 0 : 100000;
    Tracker tracker;
    for (int f = 0; f < static_cast<int>(pose.size()); ++f) {
      const Eigen::Isometry2d& world = pose[as_size(f)];
      std::vector<TrackedDetection> at;
      for (const Row& row : seen)
        if (row.frame == f) at.push_back({moved(row.box, world), row.score});
      TrackFrame frame;
      std::vector<Box3> cars_here, tracks, ignored;
      for (const Row& row : truth)
        if (row.frame == f && row.type == "Car") {
          frame.truths.push_back(offset + row.id);
          cars_here.push_back(moved(row.box, world));
        } else if (row.frame == f) {
          ignored.push_back(moved(row.box, world));
        }
      for (const Box3& box : cars_here) {
        ++cars;
        recalled += std::any_of(at.begin(), at.end(), [&](const auto& d) { return iou(d.box, box) > 0.5; });
      }
      for (const TrackState& state : tracker.step(0.1 * f, at)) {
        if (!state.confirmed) continue;
        bool counts = true;  // a track on a van is ignored
        for (const Box3& van : ignored) counts = counts && iou(state.box, van) < 0.5;
        if (!counts) continue;
        frame.tracks.push_back(offset + 50000 + state.id);
        tracks.push_back(state.box);
      }
      frame.similarity.resize(static_cast<Eigen::Index>(cars_here.size()),
                              static_cast<Eigen::Index>(tracks.size()));
      for (std::size_t t = 0; t < cars_here.size(); ++t)
        for (std::size_t k = 0; k < tracks.size(); ++k)
          frame.similarity(static_cast<Eigen::Index>(t), static_cast<Eigen::Index>(k)) =
              iou(cars_here[t], tracks[k]);
      frames.push_back(std::move(frame));
    }
  }
  const TrackScores s = score_tracks(frames, 0.25);
  RecordProperty("scores", fields_json(s).dump());
  printf("recall of detections at IoU 0.5: %.3f of %d\n%s\n", static_cast<double>(recalled) / cars, cars,
         fields_json(s).dump().c_str());
  EXPECT_GT(s.mota, 0.6);
  EXPECT_GT(s.hota, 0.5);
  EXPECT_LE(s.switches, 3);
}

}  // namespace
}  // namespace mirage
