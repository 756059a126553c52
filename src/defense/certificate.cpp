#include "defense/certificate.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <mutex>

#include "attack/clean_view.h"
#include "base/clusters.h"
#include "base/error.h"
#include "base/interrupt.h"
#include "base/intervals.h"
#include "base/progress.h"
#include "base/random.h"
#include "detection/detect.h"

namespace mirage {
namespace {

constexpr const char* kNothingWritten = "a certification writes nothing until it is done; run it again";

void check_certificate(const CertificateSettings& settings) {
  check_fields(settings);
  if (settings.sizes.empty()) throw FieldError("sizes", "", "are missing", "name one at least");
  for (const double size : settings.sizes)
    check_number({.name = "sizes", .range = {kSmallestSize, kLargestSize}}, size);
}

/// A frame before the detector, with what every mask of it needs.
struct Sight {
  Detector& detector;
  const PreparedFrame& prepared;
  EvaluationSettings by;  ///< down to the scores that AP asks for
  GroundTruth truth;
  std::vector<Detection> clean;
  std::optional<CleanView> recorded;  ///< where the detector computes only what a mask changes
  std::vector<HostTruth> hosts = {};
  std::vector<Placement> roofs = {};

  MaskedFrame behind(const Box3& box, const MaskMargin& margin) const {
    return masked(prepared.frame.image, prepared.frame.sweep, prepared.frame.calibration, box, margin);
  }
  std::vector<Detection> found(const MaskedFrame& masked) {
    SensorView view = view_of(prepared.frame, masked.image, masked.sweep);
    if (recorded) {
      recorded->changed = masked.hidden;
      view.clean = &*recorded;
    }
    return detections(detector, view, by);
  }
  ScoredFrame score(std::vector<Detection> detected) const {
    return scored(std::move(detected), truth, prepared.frame.calibration.camera.fy, by.matching);
  }
};

double best_iou(const std::vector<Detection>& proposals, const HostTruth& truth, double score) {
  double best = 0;
  for (const Detection& proposal : proposals)
    if (proposal.score() >= score) best = std::max(best, truth.host_iou(proposal));
  return best;
}

/// Random objects within the limits: dented balls, and every second one fills the box.
TexturedMesh some_object(std::uint64_t seed, int i, const AdversaryLimits& limits) {
  const std::uint64_t own = RandomStream(seed, "certified against", static_cast<std::uint64_t>(i)).next_u32();
  TexturedMesh object = random_adversary(own, limits, 0.2 * limits.half.maxCoeff());
  if (i % 2 == 0) return object;
  object.mesh = initial_adversary(limits, 1).mesh;
  return object;
}

/// Whether the object stays in the box for which certificates of these limits are.
bool fits(const TexturedMesh& object, const AdversaryLimits& limits) {
  return (half_lengths(object.mesh).array() <= limits.half.array() + 1e-9).all();
}

bool same(const MaskedFrame& a, const MaskedFrame& b) {
  return a.image.data.size() == b.image.data.size() && a.sweep.size() == b.sweep.size() &&
         std::memcmp(a.image.data.data(), b.image.data.data(), a.image.data.size() * sizeof(float)) == 0 &&
         (a.sweep.empty() ||
          std::memcmp(a.sweep.data(), b.sweep.data(), a.sweep.size() * sizeof(LidarPoint)) == 0);
}

/// A frame's part of the work.
struct FrameWork {
  std::string id;
  std::vector<std::size_t> hosts;  ///< places in the result
  ScoredFrame clean;
  std::vector<ScoredFrame> united;      ///< by size
  std::vector<std::size_t> masks;       ///< by size
  std::vector<std::size_t> violations;  ///< by size
};

class Certifier {
 public:
  Certifier(const CertificateSettings& settings, FrameStore& store, const LidarModel& lidar)
      : settings_(settings), store_(store), ground_(-lidar.height) {
    margin_ = {settings.mask_pixels, settings.mask_metres, beam_origin_spread(lidar)};
    for (double size : settings.sizes) limits_.push_back(limits_of_size(size));
  }

  void certify_frame(Detector& detector, FrameWork& work, std::vector<CertifiedHost>& hosts) const {
    const auto held = store_.get(work.id);
    const PreparedFrame& prepared = *held;
    const Frame& frame = prepared.frame;
    EvaluationSettings by = settings_.evaluation;
    by.matching = detector.capabilities().matching();
    by.score_threshold = std::min(kScoreThresholdForAp, settings_.evaluation.score_threshold);
    Sight sight{detector,
                prepared,
                by,
                ground_truth(frame, detector.region()),
                detections(detector, view_of(frame), by),
                std::nullopt};
    if (detector.capabilities().why_whole.empty()) sight.recorded = clean_view(prepared, {});
    const double score = settings_.evaluation.score_threshold;
    work.clean = sight.score(sight.clean);
    work.violations.assign(limits_.size(), 0);
    for (std::size_t place : work.hosts) {
      CertifiedHost& host = hosts[place];
      const Label& label = label_of(frame, host.id);
      const HostTruth& truth = sight.hosts.emplace_back(frame, label, by.matching);
      const Placement& roof = sight.roofs.emplace_back(store_.placement(host.id));
      host.track = label.track;
      host.range = std::hypot(label.box.bev.x, label.box.bev.y);
      host.clean_iou = best_iou(sight.clean, truth, score);
      host.sizes.resize(limits_.size());
      host.control_iou = best_iou(sight.found(sight.behind(label.box, margin_)), truth, score);
      if (!settings_.adversary) continue;
      const Simulated attacked = simulate(prepared, roof, *settings_.adversary, settings_.simulation);
      host.attacked_iou =
          best_iou(detections(detector, view_of(prepared, attacked, detector.capabilities()), by),
                   HostTruth(frame, label, by.matching, silhouette_box(attacked)), score);
    }
    for (std::size_t s = 0; s < limits_.size(); ++s) {
      for (std::size_t h = 0; h < work.hosts.size(); ++h) {
        throw_if_interrupted(kNothingWritten);
        CertifiedHost& host = hosts[work.hosts[h]];
        Certificate& certificate = host.sizes[s];
        const Box3 box = object_box(sight.roofs[h].velo_from_adversary, limits_[s]);
        const MaskedFrame recorded = sight.behind(box, margin_);
        certificate.removed = recorded.removed;
        certificate.hidden_share = static_cast<double>(recorded.hidden.width()) * recorded.hidden.height() /
                                   (static_cast<double>(frame.image.width) * frame.image.height);
        certificate.known_iou = best_iou(sight.found(recorded), sight.hosts[h], score);
        work.violations[s] += violations(prepared, sight.roofs[h], limits_[s], box, recorded);
      }
      if (settings_.with_lattice) look_through_lattice(sight, s, work, hosts);
    }
  }

 private:
  /// How many objects change something that the mask leaves: random ones, and the run's if it is in the box.
  std::size_t violations(const PreparedFrame& prepared, const Placement& roof, const AdversaryLimits& limits,
                         const Box3& box, const MaskedFrame& recorded) const {
    const Frame& frame = prepared.frame;
    const auto reaches_past = [&](const TexturedMesh& object) {
      const Simulated attacked = simulate(prepared, roof, object, settings_.simulation);
      return !same(masked(attacked.image, attacked.sweep, frame.calibration, box, margin_), recorded);
    };
    std::size_t count = 0;
    for (int i = 0; i < settings_.objects; ++i) count += reaches_past(some_object(settings_.seed, i, limits));
    if (settings_.adversary && fits(*settings_.adversary, limits))
      count += reaches_past(*settings_.adversary);
    return count;
  }

  void look_through_lattice(Sight& sight, std::size_t s, FrameWork& work,
                            std::vector<CertifiedHost>& hosts) const {
    const double score = settings_.evaluation.score_threshold;
    std::vector<Box3> objects;
    for (const Placement& roof : sight.roofs)
      objects.push_back(object_box(roof.velo_from_adversary, limits_[s]));
    std::vector<Detection> united = sight.clean;
    const std::vector<Box3> masks =
        lattice(sight.prepared.frame.calibration, limits_[s], ground_, settings_.lattice);
    for (const Box3& mask : masks) {
      throw_if_interrupted(kNothingWritten);
      const auto proposals = sight.found(sight.behind(mask, margin_));
      for (std::size_t h = 0; h < objects.size(); ++h) {
        if (!covers(mask, objects[h])) continue;
        Certificate& certificate = hosts[work.hosts[h]].sizes[s];
        certificate.covered = true;
        certificate.lattice_iou =
            std::max(certificate.lattice_iou, best_iou(proposals, sight.hosts[h], score));
      }
      united.insert(united.end(), proposals.begin(), proposals.end());
    }
    work.masks.push_back(masks.size());
    work.united.push_back(sight.score(suppress(std::move(united), sight.by.matching)));
  }

  const CertificateSettings& settings_;
  FrameStore& store_;
  double ground_;
  MaskMargin margin_;
  std::vector<AdversaryLimits> limits_;
};

/// Share of the hosts for which `holds`.
template <class Holds>
Interval share_of(const std::vector<CertifiedHost>& hosts, const Holds& holds) {
  ClusteredShare share;
  for (const CertifiedHost& host : hosts) share.add(cluster_of(host.id.frame, host.track), holds(host));
  return share.interval();
}

CertifiedShares shares_of(const std::vector<CertifiedHost>& hosts, std::size_t s) {
  CertifiedShares shares;
  const auto above = [&](auto&& value, double iou) {
    return share_of(hosts, [&](const CertifiedHost& host) { return value(host) > iou; });
  };
  const auto clean = [](const CertifiedHost& host) { return host.clean_iou; };
  const auto known = [s](const CertifiedHost& host) { return host.sizes[s].known_iou; };
  const auto by_lattice = [s](const CertifiedHost& host) { return host.sizes[s].lattice_iou; };
  shares.clean70 = above(clean, 0.7), shares.clean50 = above(clean, 0.5);
  const auto control = [](const CertifiedHost& host) { return host.control_iou; };
  const auto attacked = [](const CertifiedHost& host) { return host.attacked_iou; };
  shares.control70 = above(control, 0.7), shares.control50 = above(control, 0.5);
  shares.attacked70 = above(attacked, 0.7), shares.attacked50 = above(attacked, 0.5);
  shares.known70 = above(known, 0.7), shares.known50 = above(known, 0.5);
  shares.lattice70 = above(by_lattice, 0.7), shares.lattice50 = above(by_lattice, 0.5);
  for (const CertifiedHost& host : hosts) shares.covered += host.sizes[s].covered;
  return shares;
}

}  // namespace

std::vector<Box3> lattice(const Calibration& calibration, const AdversaryLimits& limits, double ground,
                          const LatticeSettings& settings) {
  const double reach = std::hypot(limits.half.x(), limits.half.y());
  const double side = settings.step + 2 * reach;
  const auto count = static_cast<int>(std::ceil(settings.farthest / settings.step));
  std::vector<Box3> boxes;
  for (int i = 0; i <= count; ++i)
    for (int k = -count; k <= count; ++k) {
      Box3 box;
      box.bev = {i * settings.step, k * settings.step, side, side, 0};
      box.bottom = ground + settings.roof_low;
      box.height = settings.roof_high - settings.roof_low + 2 * limits.half.z();
      if (std::hypot(box.bev.x, box.bev.y) > settings.farthest) continue;
      bool in_view = false;
      for (const Vec3d& corner : corners(box)) {
        const Vec3d p_camera = calibration.camera_from_velo * corner;
        if (p_camera.z() <= 0) continue;
        const double u = calibration.camera.project(p_camera).x();
        in_view |= u >= 0 && u < calibration.camera.width;
      }
      if (in_view) boxes.push_back(box);
    }
  return boxes;
}

bool covers(const Box3& mask, const Box3& box) {
  const auto all = corners(box);
  return std::all_of(all.begin(), all.end(), [&](const Vec3d& p) { return contains(mask, p, 1e-9); });
}

CertificateResult certify(const DetectorPool& detectors, FrameStore& store, const std::vector<HostId>& hosts,
                          const LidarModel& lidar, const CertificateSettings& settings) {
  check_certificate(settings);
  CertificateResult result;
  std::map<std::string, std::size_t> place;
  std::vector<FrameWork> frames;
  for (const HostId& id : hosts) {
    const auto [at, fresh] = place.emplace(id.frame, frames.size());
    if (fresh) frames.push_back({id.frame, {}, {}, {}, {}, {}});
    frames[at->second].hosts.push_back(result.hosts.size());
    result.hosts.push_back({id, -1, 0, 0, 0, 0, {}});
  }
  const Certifier certifier(settings, store, lidar);
  Progress progress("certify", frames.size(), settings.evaluation.quiet);
  std::mutex mutex;
  std::size_t done = 0;
  for_each_with_detector(detectors, frames.size(), [&](Detector& detector, std::size_t i) {
    certifier.certify_frame(detector, frames[i], result.hosts);
    const std::lock_guard lock(mutex);
    progress.update(++done, frames[i].id);
  });
  Clusters clusters;
  for (const CertifiedHost& host : result.hosts) clusters.add(host.id.frame, host.track);
  result.clusters = clusters.count();
  std::vector<ScoredFrame> clean;
  for (const FrameWork& frame : frames) clean.push_back(frame.clean);
  result.clean_ap70 = average_precision(clean, 0.7).average_precision;
  for (std::size_t s = 0; s < settings.sizes.size(); ++s) {
    CertifiedShares shares = shares_of(result.hosts, s);
    shares.size = settings.sizes[s];
    shares.adversary = settings.adversary && fits(*settings.adversary, limits_of_size(settings.sizes[s]));
    shares.objects = result.hosts.size() * (static_cast<std::size_t>(settings.objects) + shares.adversary);
    std::vector<ScoredFrame> united;
    std::size_t masks = 0;
    for (const FrameWork& frame : frames) {
      shares.violations += frame.violations[s];
      if (!settings.with_lattice) continue;
      united.push_back(frame.united[s]);
      masks += frame.masks[s];
    }
    if (settings.with_lattice) {
      result.masks.push_back(masks / frames.size());
      result.lattice_ap70.push_back(average_precision(united, 0.7).average_precision);
    }
    result.shares.push_back(shares);
  }
  return result;
}

nlohmann::json to_json(const CertificateResult& result, const CertificateSettings& settings) {
  auto sizes = nlohmann::json::array(), outcomes = nlohmann::json::array();
  for (std::size_t s = 0; s < result.shares.size(); ++s) {
    const CertifiedShares& of = result.shares[s];
    nlohmann::json size = {{"size", of.size},
                           {"clean_iou70", to_json(of.clean70)},
                           {"clean_iou50", to_json(of.clean50)},
                           {"control_iou70", to_json(of.control70)},
                           {"control_iou50", to_json(of.control50)},
                           {"known_roof_iou70", to_json(of.known70)},
                           {"known_roof_iou50", to_json(of.known50)},
                           {"objects", of.objects},
                           {"adversary_among_them", of.adversary},
                           {"violations", of.violations}};
    if (settings.adversary) {
      size["attacked_iou70"] = to_json(of.attacked70);
      size["attacked_iou50"] = to_json(of.attacked50);
    }
    if (settings.with_lattice) {
      size["lattice_iou70"] = to_json(of.lattice70);
      size["lattice_iou50"] = to_json(of.lattice50);
      size["covered"] = of.covered;
      size["masks"] = result.masks[s];
      size["lattice_ap70"] = result.lattice_ap70[s];
    }
    sizes.push_back(std::move(size));
  }
  for (const CertifiedHost& host : result.hosts) {
    auto certificates = nlohmann::json::array();
    for (const Certificate& c : host.sizes) {
      certificates.push_back(
          {{"known_iou", c.known_iou}, {"removed", c.removed}, {"hidden_share", c.hidden_share}});
      if (settings.with_lattice)
        certificates.back().update({{"lattice_iou", c.lattice_iou}, {"covered", c.covered}});
    }
    outcomes.push_back({{"frame", host.id.frame},
                        {"label", host.id.label},
                        {"track", host.track},
                        {"range", host.range},
                        {"clean_iou", host.clean_iou},
                        {"control_iou", host.control_iou},
                        {"sizes", certificates}});
    if (settings.adversary) outcomes.back()["attacked_iou"] = host.attacked_iou;
  }
  return {{"hosts", result.hosts.size()},
          {"clusters", to_json(result.clusters)},
          {"score_threshold", settings.evaluation.score_threshold},
          {"clean_ap70", result.clean_ap70},
          {"mask_pixels", settings.mask_pixels},
          {"mask_metres", settings.mask_metres},
          {"sizes", sizes},
          {"outcomes", outcomes}};
}

}  // namespace mirage
