#include "detection/shadow_detector.h"

#include "base/error.h"
#include "detection/around.h"
#include "detection/body_evidence.h"
#include "detection/defense_words.h"

namespace mirage {
namespace {

/// An answer's logit and its derivative by that of the detector's proposal `from`.
struct Answer {
  std::size_t from = 0;
  double logit = 0, slope = 1;
};

/// What a body makes of a logit: continuous and rising.
Answer raised(std::size_t from, double logit) {
  if (logit >= kBodyLogit) return {from, logit, 1};
  const double lifted = logit + kBodyLift, level = kBodyLogit + kBodySlope * (logit - kBodyLogit);
  return lifted < level ? Answer{from, lifted, 1} : Answer{from, level, kBodySlope};
}

Answer sunk(std::size_t from, double logit) {
  if (logit <= kThroughLogit) return {from, logit, 1};
  return {from, kThroughLogit + kBodySlope * (logit - kThroughLogit), kBodySlope};
}

class ShadowDetector : public DetectorAround {
 public:
  using DetectorAround::DetectorAround;

  std::vector<Detection> forward(const SensorView& view, double score_threshold, bool keep_graph) override {
    const auto found = inner_->forward(view, speaking_score(score_threshold), keep_graph);
    count_ = found.size();
    const BodyEvidence evidence(view.points);
    const std::vector<BevBox> bodies = evidence.bodies();
    std::vector<std::ptrdiff_t> loudest(bodies.size(), -1);  // proposal at each body
    std::vector<Detection> result;
    answers_.clear();
    const auto add = [&](Detection proposal, const Answer& answer) {
      proposal.logit = answer.logit;
      if (!(proposal.score() > score_threshold)) return;
      result.push_back(proposal);
      answers_.push_back(answer);
    };
    for (std::size_t i = 0; i < count_; ++i) {
      const Detection& proposal = found[i];
      bool stands = false;
      for (std::size_t b = 0; b < bodies.size(); ++b)
        if (same_place(proposal.box.bev, bodies[b])) {
          stands = true;
          if (loudest[b] < 0 || found[static_cast<std::size_t>(loudest[b])].logit < proposal.logit)
            loudest[b] = static_cast<std::ptrdiff_t>(i);
        }
      if (stands) {
        add(proposal, raised(i, proposal.logit));
      } else if (proposal.logit > kThroughLogit) {
        const RayCount rays = evidence.rays(proposal.box.bev);
        const bool empty = rays.passed >= kThroughRays && rays.passed > rays.stopped;
        add(proposal, empty ? sunk(i, proposal.logit) : Answer{i, proposal.logit, 1});
      } else {
        add(proposal, {i, proposal.logit, 1});
      }
    }
    for (std::size_t b = 0; b < bodies.size(); ++b) {
      if (loudest[b] < 0) continue;
      const auto i = static_cast<std::size_t>(loudest[b]);
      if (found[i].logit >= kBodyLogit) continue;  // is found as it is
      Detection own = found[i];
      own.box.bev = bodies[b];
      Answer answer = raised(i, found[i].logit);
      answer.logit += 1e-3;  // before the proposals, whose boxes may have been turned by what hides the car
      add(own, answer);
    }
    return result;
  }

  SensorGradient backward(std::span<const double> d_logits) override {
    std::vector<double> parts(count_, 0.0);
    for (std::size_t k = 0; k < d_logits.size(); ++k)
      parts[answers_.at(k).from] += answers_[k].slope * d_logits[k];
    return inner_->backward(parts);
  }

  std::unique_ptr<Detector> share() override {
    auto other = inner_->share();
    return other ? std::make_unique<ShadowDetector>(std::move(other)) : nullptr;
  }

 private:
  std::size_t count_ = 0;        ///< of the last forward's proposals
  std::vector<Answer> answers_;  ///< of its answers
};

}  // namespace

std::unique_ptr<Detector> with_shadows(std::unique_ptr<Detector> detector) {
  const Capabilities can = detector->capabilities();
  if (!can.finds_bev || !can.reads_points)
    throw FieldError("defense", kShadows,
                     detector->name() + " finds no boxes from above, or reads no returns",
                     "use it with lidar, painted, fusion, late or refined");
  return std::make_unique<ShadowDetector>(std::move(detector));
}

}  // namespace mirage
