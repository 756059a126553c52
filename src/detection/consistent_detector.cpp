#include "detection/consistent_detector.h"

#include <algorithm>

#include "detection/car_in_picture.h"
#include "detection/defenses.h"
#include "detection/detector_settings.h"

namespace mirage {
namespace {

constexpr double kSamePicture = 0.3;  // IoU

/// The member and the proposal that a logit comes from.
struct Source {
  enum Member { fused, lidar, camera, nobody } member = nobody;
  std::size_t index = 0;
};

/// A logit of one of the members.
struct Vote {
  double logit = kNoDetectionLogit;
  Source source;
};

/// The answer's logit is (1 − share) · first + share · second, and a constant.
struct Blend {
  Source first, second;
  double share = 0;
};

/// Proposals above kNoDetectionLogit, the most certain first.
std::vector<std::size_t> by_confidence(const std::vector<Detection>& proposals) {
  std::vector<std::size_t> order;
  for (std::size_t i = 0; i < proposals.size(); ++i)
    if (proposals[i].logit > kNoDetectionLogit) order.push_back(i);
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return proposals[a].logit > proposals[b].logit; });
  return order;
}

/// The camera network's votes for boxes that are known from above.
class CameraVotes {
 public:
  CameraVotes(const SensorView& view, const std::vector<Detection>& boxes)
      : boxes_(boxes), order_(by_confidence(boxes)), returns_(floats_of(view.points)) {
    if (!view.image || view.image->empty() || !view.calibration) return;
    width_ = view.image->width, height_ = view.image->height;
    projection_ = pixel_from_velo(*view.calibration);
  }
  Vote of(const BevBox& box) const {
    if (width_ == 0) return {};
    const auto seen = car_in_picture(box, returns_.ground(box), projection_, width_, height_);
    if (!seen) return {};
    for (const std::size_t k : order_)  // as far as the picture shows it
      if (iou(*seen, within(boxes_[k].picture, width_, height_)) > kSamePicture)
        return {boxes_[k].logit, {Source::camera, k}};
    return {};
  }

 private:
  const std::vector<Detection>& boxes_;
  std::vector<std::size_t> order_;
  LowestReturns returns_;
  std::array<double, 12> projection_{};
  int width_ = 0, height_ = 0;
};

class ConsistentDetector : public DetectorWrapper {
 public:
  ConsistentDetector(std::unique_ptr<Detector> fused, std::unique_ptr<Detector> lidar,
                     std::unique_ptr<Detector> camera)
      : DetectorWrapper(std::move(fused)),
        lidar_(std::move(lidar)),
        camera_(std::move(camera)),
        members_{inner_.get(), lidar_.get(), camera_.get()} {}

  Capabilities capabilities() const override {
    Capabilities combined = inner_->capabilities();
    combined.reads_image = combined.reads_points = true;
    for (const Detector* member : members_) {
      const Capabilities its = member->capabilities();
      if (its.reads_points) combined.knows_presence = combined.knows_presence && its.knows_presence;
      if (combined.why_whole.empty()) combined.why_whole = its.why_whole;
    }
    return combined;
  }

  std::vector<Detection> forward(const SensorView& view, double score_threshold, bool keep_graph) override {
    std::array<std::vector<Detection>, 3> found;
    const bool no_picture = !view.image || view.image->empty();
    for (std::size_t m = 0; m < members_.size(); ++m) {
      if (m == Source::camera && no_picture) continue;  // says nothing
      found[m] = members_[m]->forward(view, reporting_threshold(score_threshold), keep_graph);
    }
    for (std::size_t m = 0; m < members_.size(); ++m) counts_[m] = found[m].size();
    const CameraVotes picture(view, found[Source::camera]);
    const std::vector<std::size_t> lidar_order = by_confidence(found[Source::lidar]);
    std::vector<Detection> result;
    blends_.clear();
    const auto add = [&](Detection proposal, double logit, const Blend& blend) {
      proposal.logit = logit;
      if (!(proposal.score() > score_threshold)) return;
      result.push_back(proposal);
      blends_.push_back(blend);
    };
    for (std::size_t i = 0; i < found[Source::fused].size(); ++i) {
      const Detection& proposal = found[Source::fused][i];
      const Source own{Source::fused, i};
      double cap = proposal.logit;
      Vote vote;
      if (proposal.logit > kMinVotingLogit) {
        vote = picture.of(proposal.box.bev);
        for (const std::size_t j : lidar_order) {
          const Detection& other = found[Source::lidar][j];
          if (other.logit <= vote.logit) break;  // as are all that follow
          if (!same_place(proposal.box.bev, other.box.bev)) continue;
          vote = {other.logit, {Source::lidar, j}};
          break;
        }
        cap = vote.logit + kVoteMargin;
      }
      if (cap < proposal.logit)
        add(proposal, (1 - kVoteLeak) * cap + kVoteLeak * proposal.logit, {vote.source, own, kVoteLeak});
      else
        add(proposal, proposal.logit, {own, {}, 0});
    }
    for (const std::size_t j : lidar_order) {
      const Detection& proposal = found[Source::lidar][j];
      if (proposal.logit <= kMinVotingLogit) break;
      Vote low = picture.of(proposal.box.bev), high{proposal.logit, {Source::lidar, j}};
      if (low.source.member == Source::nobody) continue;
      if (high.logit < low.logit) std::swap(low, high);
      add(proposal, (1 - kVoteLeak) * low.logit + kVoteLeak * high.logit,
          {low.source, high.source, kVoteLeak});
    }
    return result;
  }

  SensorGradient backward(std::span<const double> d_logits) override {
    std::array<std::vector<double>, 3> parts;
    std::array<bool, 3> contributes{};
    for (std::size_t m = 0; m < members_.size(); ++m) parts[m].assign(counts_[m], 0.0);
    const auto give = [&](const Source& source, double d_logit) {
      if (source.member == Source::nobody || d_logit == 0) return;
      parts[source.member][source.index] += d_logit;
      contributes[source.member] = true;
    };
    for (std::size_t i = 0; i < d_logits.size(); ++i) {
      const Blend& blend = blends_.at(i);
      give(blend.first, (1 - blend.share) * d_logits[i]);
      give(blend.second, blend.share * d_logits[i]);
    }
    SensorGradient sum = inner_->backward(parts[Source::fused]);
    for (const auto member : {Source::lidar, Source::camera})
      if (contributes[member]) add(sum, members_[member]->backward(parts[member]));
    return sum;
  }

  std::unique_ptr<Detector> share() override {
    std::array<std::unique_ptr<Detector>, 3> others;
    for (std::size_t m = 0; m < members_.size(); ++m)
      if (others[m] = members_[m]->share(); !others[m]) return nullptr;
    return std::make_unique<ConsistentDetector>(std::move(others[0]), std::move(others[1]),
                                                std::move(others[2]));
  }

 private:
  /// `sum` += `more`; missing values are zero.
  static void add(SensorGradient& sum, const SensorGradient& more) {
    if (sum.image.empty())
      sum.image = more.image;
    else
      for (std::size_t i = 0; i < more.image.data.size(); ++i) sum.image.data[i] += more.image.data[i];
    for (std::size_t i = 0; i < more.points.size(); ++i)
      for (std::size_t c = 0; c < 4; ++c) sum.points[i][c] += more.points[i][c];
    if (sum.presence.empty()) sum.presence.resize(more.presence.size());
    for (std::size_t i = 0; i < more.presence.size(); ++i) sum.presence[i] += more.presence[i];
    for (const auto& [name, values] : more.others) {
      std::vector<float>& its = sum.others[name];
      its.resize(std::max(its.size(), values.size()));
      for (std::size_t i = 0; i < values.size(); ++i) its[i] += values[i];
    }
  }

  std::unique_ptr<Detector> lidar_, camera_;
  std::array<Detector*, 3> members_;     ///< by Source::Member
  std::array<std::size_t, 3> counts_{};  ///< of the last forward's proposals
  std::vector<Blend> blends_;            ///< of its answers
};

}  // namespace

std::unique_ptr<Detector> with_consistency(std::unique_ptr<Detector> fused, std::unique_ptr<Detector> lidar,
                                           std::unique_ptr<Detector> camera) {
  if (!fused->capabilities().finds_bev)
    throw FieldError("defense", kConsistency, fused->name() + " finds no boxes from above",
                     "use it with lidar, painted, fusion, late or refined");
  if (!lidar->capabilities().finds_bev || !camera->capabilities().finds_picture)
    throw FieldError("defense", kConsistency, "its single-sensor detectors do not find boxes",
                     "give a LiDAR and a camera detector");
  return std::make_unique<ConsistentDetector>(std::move(fused), std::move(lidar), std::move(camera));
}

}  // namespace mirage
