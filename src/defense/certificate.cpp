#include "defense/certificate.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <span>

#include "attack/observation.h"
#include "base/error.h"
#include "base/logging.h"
#include "base/random.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "detection/detect.h"
#include "simulation/render_scene.h"

namespace mirage {
namespace {

/// IoU of the strictest rule for a found car.
constexpr double kStrictest = 0.7;

void check_certificate(const CertificateSettings& settings) {
  check_fields(settings);
  if (settings.sizes.empty()) throw FieldError("sizes", "", "are missing", "name one at least");
  for (const double size : settings.sizes)
    check_number({.name = "sizes", .range = {kMinAdversarySize, kMaxAdversarySize}}, size);
}

/// A frame for the detector, with the data that its masks share.
struct MaskedView {
  Detector& detector;
  const PreparedFrame& prepared;
  EvaluationSettings by;  ///< with the score threshold of AP
  std::vector<Detection> clean;
  std::optional<UnchangedInput> recorded;  ///< set if the detector computes only a mask's changes
  std::vector<HostTruth> hosts = {};
  std::vector<Placement> roofs = {};

  MaskedFrame behind(const Box3& box, const MaskMargin& margin) const {
    return masked(prepared.frame.image, prepared.frame.sweep, prepared.frame.calibration, box, margin);
  }
  /// `elsewhere`: pixels that were changed before masking.
  std::vector<Detection> found(const MaskedFrame& masked, const PixelRect& elsewhere = {}) {
    SensorView view = view_of(prepared.frame, masked.image, masked.sweep);
    if (recorded) {
      recorded->changed = united(masked.hidden, elsewhere);
      view.clean = &*recorded;
    }
    return detections(detector, view, by);
  }
};

double best_iou(const std::vector<Detection>& proposals, const HostTruth& truth, double score) {
  double best = 0;
  for (const Detection& proposal : proposals)
    if (proposal.score() >= score) best = std::max(best, truth.host_iou(proposal));
  return best;
}

/// A random object within the limits: a dented ellipsoid for even i; for odd i it fills the box.
TexturedMesh random_object(std::uint64_t seed, int i, const AdversaryLimits& limits) {
  const std::uint64_t own = RandomStream(seed, "certified against", static_cast<std::uint64_t>(i)).next_u32();
  TexturedMesh object = random_adversary(own, limits, 0.2 * limits.half.maxCoeff());
  if (i % 2 == 0) return object;
  object.mesh = initial_adversary(limits, 1).mesh;
  return object;
}

/// Whether the object stays in the box of these limits.
bool fits(const TexturedMesh& object, const AdversaryLimits& limits) {
  return (half_lengths(object.mesh).array() <= limits.half.array() + 1e-9).all();
}

bool same(const MaskedFrame& a, const MaskedFrame& b) {
  const auto equal = [](const auto& one, const auto& other) {
    return std::ranges::equal(std::as_bytes(std::span(one)), std::as_bytes(std::span(other)));
  };
  return equal(a.image.data, b.image.data) && equal(a.sweep, b.sweep);
}

/// Best IoU with each host under each known object.
using AttackedIou = std::map<HostId, std::vector<double>>;

/// A frame's part of the work.
struct FrameWork {
  std::string id;
  std::vector<std::size_t> hosts;  ///< indices into the result
  std::vector<Detection> clean;
  ViewAnswers united;                   ///< detections of the whole lattice, by size
  std::vector<std::size_t> masks;       ///< by size
  std::vector<std::size_t> violations;  ///< by size
};

/// Calls use() on every stored number of a frame and its hosts.
template <class Use>
void for_each_number(FrameWork& work, std::vector<CertifiedHost>& hosts, std::size_t sizes, const Use& use) {
  work.violations.resize(sizes);
  for (std::size_t& count : work.violations) use(count);
  std::size_t with_masks = work.masks.size();
  use(with_masks);
  work.masks.resize(with_masks);
  for (std::size_t& count : work.masks) use(count);
  for (const std::size_t place : work.hosts) {
    CertifiedHost& host = hosts[place];
    host.sizes.resize(sizes);
    use(host.track), use(host.range), use(host.clean_iou), use(host.control_iou);
    for (auto& [with_roof, lattice, attacked, survived, covered, removed, hidden] : host.sizes) {
      for (double* iou : {&with_roof, &lattice, &attacked, &survived}) use(*iou);
      use(covered), use(removed), use(hidden);
    }
  }
}

class Certifier {
 public:
  Certifier(const CertificateSettings& settings, FrameStore& store, const LidarModel& lidar,
            const AttackedIou& attacked)
      : settings_(settings), store_(store), attacked_(attacked), ground_(-lidar.height) {
    margin_ = {settings.mask_pixels, settings.mask_metres, beam_origin_spread(lidar)};
    for (double size : settings.sizes) limits_.push_back(limits_of_size(size));
    for (const TexturedMesh& adversary : settings.adversaries) adversaries_.push_back(hash_of(adversary));
  }

  /// Reads the frame's cached result, or computes and caches it.
  void work_on(Detector& detector, FrameWork& work, std::vector<CertifiedHost>& hosts) const {
    const auto now = [&] {
      FrameAnswers answers;
      certify_frame(detector, work, hosts);
      answers.found = work.united;
      answers.found.push_back(work.clean);
      for_each_number(work, hosts, limits_.size(),
                      [&](const auto& number) { answers.numbers.push_back(static_cast<double>(number)); });
      return answers;
    };
    if (!is_cached_on_disk(store_, settings_.evaluation)) {
      now();
      return;
    }
    FrameAnswers answers = store_.cache().answers("certified", provenance(work, hosts), now);
    work.clean = std::move(answers.found.back());
    answers.found.pop_back();
    work.united = std::move(answers.found);
    std::size_t i = 0;
    for_each_number(work, hosts, limits_.size(), [&](auto& number) {
      number = static_cast<std::decay_t<decltype(number)>>(answers.numbers.at(i++));
    });
  }

 private:
  Provenance provenance(const FrameWork& work, const std::vector<CertifiedHost>& hosts) const {
    Provenance provenance = store_.provenance(hosts[work.hosts.front()].id);
    nlohmann::json all;
    for (const std::size_t place : work.hosts) {
      const HostId& id = hosts[place].id;
      all.push_back(
          {host_name(id), settings_.adversaries.empty() ? std::vector<double>() : attacked_.at(id)});
    }
    provenance.set("hosts", std::move(all));
    provenance.add(settings_);
    provenance.set("sizes", settings_.sizes);
    provenance.set("seed", settings_.seed);
    provenance.set("roof_low", settings_.lattice.roof_low);
    provenance.set("roof_high", settings_.lattice.roof_high);
    provenance.set("simulation", fields_json(settings_.simulation));
    provenance.set("adversaries", adversaries_);
    provenance.set("score_threshold", settings_.evaluation.score_threshold);
    provenance.input("detector", settings_.evaluation.detector_identity);
    return provenance;
  }

  void certify_frame(Detector& detector, FrameWork& work, std::vector<CertifiedHost>& hosts) const {
    const auto frame_handle = store_.get(work.id);
    const PreparedFrame& prepared = *frame_handle;
    const Frame& frame = prepared.frame;
    require_first_sensors(detector.capabilities(), frame, "certificate");
    EvaluationSettings by = settings_.evaluation;
    by.matching = detector.capabilities().matching();
    by.score_threshold = std::min(kScoreThresholdForAp, settings_.evaluation.score_threshold);
    MaskedView sight{detector, prepared, by, detections(detector, view_of(frame), by), std::nullopt};
    if (detector.capabilities().why_whole.empty()) sight.recorded = unchanged_input(prepared, {});
    const double score = settings_.evaluation.score_threshold;
    work.clean = sight.clean;
    work.violations.assign(limits_.size(), 0);
    for (std::size_t place : work.hosts) {
      CertifiedHost& host = hosts[place];
      const Label& label = label_of(frame, host.id);
      const HostTruth& truth = sight.hosts.emplace_back(frame, label, by.matching);
      sight.roofs.push_back(store_.placement(host.id));
      host.track = label.track;
      host.range = horizontal_distance(label.box.bev);
      host.clean_iou = best_iou(sight.clean, truth, score);
      host.sizes.resize(limits_.size());
      host.control_iou = best_iou(sight.found(sight.behind(label.box, margin_)), truth, score);
    }
    for (std::size_t s = 0; s < limits_.size(); ++s) {
      for (std::size_t h = 0; h < work.hosts.size(); ++h) {
        throw_if_interrupted(how_to_go_on(store_, settings_.evaluation));
        CertifiedHost& host = hosts[work.hosts[h]];
        Certificate& certificate = host.sizes[s];
        const Box3 box = object_box(sight.roofs[h].velo_from_adversary, limits_[s]);
        const MaskedFrame recorded = sight.behind(box, margin_);
        certificate.removed = recorded.removed;
        certificate.hidden_share = static_cast<double>(recorded.hidden.width()) * recorded.hidden.height() /
                                   (static_cast<double>(frame.image.width) * frame.image.height);
        certificate.with_roof_iou = best_iou(sight.found(recorded), sight.hosts[h], score);
        certificate.attacked_iou = host.clean_iou;
        for_those_in(limits_[s], host.id, [&](const TexturedMesh&, double iou) {
          certificate.attacked_iou = std::min(certificate.attacked_iou, iou);
        });
        work.violations[s] += violations(prepared, sight.roofs[h], limits_[s], box, recorded);
      }
      if (settings_.with_lattice) look_through_lattice(sight, s, work, hosts);
    }
  }

  /// Calls visitor(adversary, best IoU with the host) for every adversary that stays in the box.
  template <class Visitor>
  void for_those_in(const AdversaryLimits& limits, const HostId& id, const Visitor& visitor) const {
    for (std::size_t i = 0; i < settings_.adversaries.size(); ++i)
      if (fits(settings_.adversaries[i], limits)) visitor(settings_.adversaries[i], attacked_.at(id)[i]);
  }

  /// Number of objects that change something outside the mask: random ones, and the adversaries in the box.
  std::size_t violations(const PreparedFrame& prepared, const Placement& roof, const AdversaryLimits& limits,
                         const Box3& box, const MaskedFrame& recorded) const {
    const Frame& frame = prepared.frame;
    const auto reaches_past = [&](const TexturedMesh& object) {
      const Simulated attacked = simulate(prepared, roof, object, settings_.simulation);
      return !same(masked(attacked.image, attacked.sweep, frame.calibration, box, margin_), recorded);
    };
    std::size_t count = 0;
    if (settings_.objects == 0) return count;
    for (int i = 0; i < settings_.objects; ++i)
      count += reaches_past(random_object(settings_.seed, i, limits));
    for (const TexturedMesh& adversary : settings_.adversaries)
      count += fits(adversary, limits) && reaches_past(adversary);
    return count;
  }

  void look_through_lattice(MaskedView& sight, std::size_t s, FrameWork& work,
                            std::vector<CertifiedHost>& hosts) const {
    const double score = settings_.evaluation.score_threshold;
    std::vector<Box3> objects;
    for (const Placement& roof : sight.roofs)
      objects.push_back(object_box(roof.velo_from_adversary, limits_[s]));
    std::vector<Detection> whole = sight.clean;
    const std::vector<Box3> masks =
        lattice(sight.prepared.frame.calibration, limits_[s], ground_, settings_.lattice);
    for (const Box3& mask : masks) {
      throw_if_interrupted(how_to_go_on(store_, settings_.evaluation));
      const auto holds = [&](const Box3& object) { return covers(mask, object); };
      bool needs_lattice = settings_.whole_lattice;  // or only for cars not yet certified
      for (std::size_t h = 0; h < objects.size() && !needs_lattice; ++h)
        needs_lattice = hosts[work.hosts[h]].sizes[s].lattice_iou <= kStrictest && holds(objects[h]);
      if (!needs_lattice) continue;
      const auto proposals = sight.found(sight.behind(mask, margin_));
      for (std::size_t h = 0; h < objects.size(); ++h) {
        Certificate& certificate = hosts[work.hosts[h]].sizes[s];
        const double iou = best_iou(proposals, sight.hosts[h], score);
        certificate.survived_iou = std::max(certificate.survived_iou, iou);
        if (!holds(objects[h])) continue;
        certificate.covered = true;
        certificate.lattice_iou = std::max(certificate.lattice_iou, iou);
      }
      whole.insert(whole.end(), proposals.begin(), proposals.end());
    }
    work.masks.push_back(masks.size());
    if (!settings_.whole_lattice) return;
    work.united.push_back(suppress(std::move(whole), sight.by.matching));
    for (std::size_t h = 0; h < objects.size(); ++h) {
      CertifiedHost& host = hosts[work.hosts[h]];
      Certificate& certificate = host.sizes[s];
      certificate.survived_iou = std::max(certificate.survived_iou, host.clean_iou);
      for_those_in(limits_[s], host.id, [&](const TexturedMesh& adversary, double iou) {
        const double best = std::max(certificate.lattice_iou, iou);
        if (std::min(certificate.survived_iou, kStrictest) > best)
          certificate.survived_iou =
              std::min(certificate.survived_iou,
                       attacked_through(sight, h, host.id, adversary, masks, objects[h], best));
        else
          certificate.survived_iou = std::min(certificate.survived_iou, best);
      });
    }
  }

  /// The larger of `best` and the best IoU with the host under the adversary, over masks that do not cover
  /// its roof. Nearest masks come first; stops above kStrictest.
  double attacked_through(MaskedView& sight, std::size_t h, const HostId& id, const TexturedMesh& adversary,
                          std::vector<Box3> masks, const Box3& object, double best) const {
    const PreparedFrame& prepared = sight.prepared;
    const Simulated attacked = simulate(prepared, sight.roofs[h], adversary, settings_.simulation);
    const HostTruth truth(prepared.frame, label_of(prepared.frame, id), sight.by.matching,
                          carried_box(attacked, sight.roofs[h]));
    const auto away = [&](const Box3& mask) { return horizontal_distance(mask.bev, object.bev); };
    std::ranges::stable_sort(masks, {}, away);
    for (const Box3& mask : masks) {
      throw_if_interrupted(how_to_go_on(store_, settings_.evaluation));
      if (best > kStrictest) break;
      if (covers(mask, object)) continue;
      const auto proposals = sight.found(
          masked(attacked.image, attacked.sweep, prepared.frame.calibration, mask, margin_), attacked.rect);
      best = std::max(best, best_iou(proposals, truth, settings_.evaluation.score_threshold));
    }
    return best;
  }

  const CertificateSettings& settings_;
  FrameStore& store_;
  const AttackedIou& attacked_;
  double ground_;
  MaskMargin margin_;
  std::vector<AdversaryLimits> limits_;
  std::vector<std::string> adversaries_;  ///< content hashes
};

CertifiedShares shares_of(const std::vector<CertifiedHost>& hosts, std::size_t s) {
  CertifiedShares shares;
  double nearest = 0, farthest = std::numeric_limits<double>::infinity();
  const auto above = [&](const auto& value, double iou) {
    ClusteredShare share;
    for (const CertifiedHost& host : hosts)
      if (host.range >= nearest && host.range < farthest)
        share.add(cluster_of(host.id.frame, host.track), value(host) > iou);
    return share.interval();
  };
  const auto of_size = [s](const auto& value) {
    return [s, value](const CertifiedHost& host) { return value(host.sizes[s]); };
  };
  const auto clean = [](const CertifiedHost& host) { return host.clean_iou; };
  const auto control = [](const CertifiedHost& host) { return host.control_iou; };
  const auto attacked = of_size([](const Certificate& of) { return of.attacked_iou; });
  const auto with_roof = of_size([](const Certificate& of) { return of.with_roof_iou; });
  const auto by_lattice = of_size([](const Certificate& of) { return of.lattice_iou; });
  const auto with_or_without =
      of_size([](const Certificate& of) { return std::max(of.with_roof_iou, of.attacked_iou); });
  const auto survived = of_size([](const Certificate& of) { return of.survived_iou; });
  shares.clean70 = above(clean, kStrictest), shares.clean50 = above(clean, 0.5);
  shares.control70 = above(control, kStrictest), shares.control50 = above(control, 0.5);
  shares.attacked70 = above(attacked, kStrictest), shares.attacked50 = above(attacked, 0.5);
  for (const CertifiedHost& host : hosts) shares.covered += host.sizes[s].covered;
  for (std::size_t b = 0; b < shares.bands.size(); ++b) {
    if (b > 0) nearest = kScoreBands[b - 1], farthest = kScoreBands[b];
    CertifiedBand& band = shares.bands[b];
    band.nearest = nearest, band.farthest = farthest;
    band.hosts = static_cast<int>(std::ranges::count_if(
        hosts, [&](const CertifiedHost& host) { return host.range >= nearest && host.range < farthest; }));
    band.known70 = {above(with_roof, kStrictest), above(with_or_without, kStrictest)};
    band.known50 = {above(with_roof, 0.5), above(with_or_without, 0.5)};
    band.lattice70 = {above(by_lattice, kStrictest), above(survived, kStrictest)};
    band.lattice50 = {above(by_lattice, 0.5), above(survived, 0.5)};
  }
  return shares;
}

/// Best IoU of each host under each adversary, from settings.attacked or by evaluation.
AttackedIou attacked_iou(const DetectorPool& detectors, FrameStore& store, const std::vector<HostId>& hosts,
                         const CertificateSettings& settings) {
  AttackedIou attacked;
  if (settings.adversaries.empty()) return attacked;
  std::vector<HostOutcome> own;
  std::span<const HostOutcome> outcomes = settings.attacked;
  if (outcomes.empty()) {
    EvaluationSettings by = settings.evaluation;
    by.reports_outcomes = true;  // needed on every rank
    by.matching = detectors.front()->capabilities().matching();
    own = evaluate(detectors, store, hosts, clean_detections(detectors, store, hosts, by),
                   settings.adversaries, settings.simulation, by)
              .hosts;
    outcomes = own;
  }
  const std::size_t count = settings.adversaries.size();
  for (const HostOutcome& outcome : outcomes) {
    std::vector<double>& of = attacked[outcome.id];
    of.resize(count, -1);
    of.at(as_size(outcome.mesh)) = outcome.attacked_iou;
  }
  for (const HostId& id : hosts)
    if (!attacked.contains(id) || std::ranges::count(attacked.at(id), -1) > 0)
      throw FieldError("attacked", host_name(id), "has no outcome under every adversary", "evaluate it");
  return attacked;
}

/// The bands as JSON; a bracket has `attacked` only if it was computed.
nlohmann::json bands_json(const CertifiedShares& shares, const CertificateSettings& settings) {
  auto bands = nlohmann::json::array();
  for (const CertifiedBand& band : shares.bands) {
    bands.push_back(
        {{"from_m", band.nearest},
         {"to_m", std::isfinite(band.farthest) ? nlohmann::json(band.farthest) : nlohmann::json()},
         {"hosts", band.hosts}});
    const auto add = [&](const char* name, const Bracket& bracket, bool attacked) {
      bands.back()[name]["certified"] = to_json(bracket.certified);
      if (attacked) bands.back()[name]["attacked"] = to_json(bracket.attacked);
    };
    add("known70", band.known70, true);
    add("known50", band.known50, true);
    if (!settings.with_lattice) continue;
    add("lattice70", band.lattice70, settings.whole_lattice);
    add("lattice50", band.lattice50, settings.whole_lattice);
  }
  return bands;
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
      if (horizontal_distance(box.bev) > settings.farthest) continue;
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
    result.hosts.push_back({id, -1, 0, 0, 0, {}});
  }
  const AttackedIou attacked = attacked_iou(detectors, store, hosts, settings);
  const Certifier certifier(settings, store, lidar, attacked);
  Progress progress("certify", frames.size(), settings.evaluation.quiet);
  const std::vector<std::size_t> order = order_among_ranks(frames.size());
  for_each_with_detector(detectors, frames.size(), [&](Detector& detector, std::size_t k) {
    throw_if_interrupted(how_to_go_on(store, settings.evaluation));
    FrameWork& work = frames[order[k]];
    certifier.work_on(detector, work, result.hosts);
    progress.add(1, work.id);
  });
  if (rank() > 0) return {};
  Clusters clusters;
  for (const CertifiedHost& host : result.hosts) clusters.add(host.id.frame, host.track);
  result.clusters = clusters.count();
  std::vector<ScoredFrame> clean;
  std::vector<std::vector<ScoredFrame>> united(settings.sizes.size());
  const Matching matching = detectors.front()->capabilities().matching();
  for (FrameWork& work : frames) {
    const auto prepared = store.get(work.id);
    const Frame& frame = prepared->frame;
    const GroundTruth truth =
        ground_truth(frame, detectors.front()->region(), detectors.front()->capabilities());
    const auto score = [&](std::vector<Detection>& found) {
      return scored(std::move(found), truth, frame.calibration.camera.fy, matching);
    };
    clean.push_back(score(work.clean));
    for (std::size_t s = 0; s < work.united.size(); ++s) united[s].push_back(score(work.united[s]));
  }
  result.clean_ap70 = average_precision(clean, 0.7).average_precision;
  for (std::size_t s = 0; s < settings.sizes.size(); ++s) {
    CertifiedShares shares = shares_of(result.hosts, s);
    shares.size = settings.sizes[s];
    shares.adversaries =
        static_cast<int>(std::ranges::count_if(settings.adversaries, [&](const TexturedMesh& adversary) {
          return fits(adversary, limits_of_size(settings.sizes[s]));
        }));
    if (settings.objects > 0)
      shares.objects = result.hosts.size() * as_size(settings.objects + shares.adversaries);
    std::size_t masks = 0;
    for (const FrameWork& frame : frames) {
      shares.violations += frame.violations[s];
      if (settings.with_lattice) masks += frame.masks[s];
    }
    if (settings.with_lattice) result.masks.push_back(masks / frames.size());
    if (!united[s].empty())
      result.lattice_ap70.push_back(average_precision(united[s], 0.7).average_precision);
    result.shares.push_back(shares);
  }
  return result;
}

nlohmann::json to_json(const CertificateResult& result, const CertificateSettings& settings) {
  auto sizes = nlohmann::json::array(), outcomes = nlohmann::json::array();
  for (std::size_t s = 0; s < result.shares.size(); ++s) {
    const CertifiedShares& of = result.shares[s];
    const CertifiedBand& any = of.bands.front();
    nlohmann::json size = {{"size", of.size},
                           {"clean_iou70", to_json(of.clean70)},
                           {"clean_iou50", to_json(of.clean50)},
                           {"control_iou70", to_json(of.control70)},
                           {"control_iou50", to_json(of.control50)},
                           {"known_roof_iou70", to_json(any.known70.certified)},
                           {"known_roof_iou50", to_json(any.known50.certified)},
                           {"adversaries", of.adversaries},
                           {"objects", of.objects},
                           {"violations", of.violations},
                           {"bands", bands_json(of, settings)}};
    if (of.adversaries > 0) {
      size["attacked_iou70"] = to_json(of.attacked70);
      size["attacked_iou50"] = to_json(of.attacked50);
    }
    if (settings.with_lattice) {
      size["lattice_iou70"] = to_json(any.lattice70.certified);
      size["lattice_iou50"] = to_json(any.lattice50.certified);
      size["covered"] = of.covered;
      size["masks"] = result.masks[s];
      if (settings.whole_lattice) size["lattice_ap70"] = result.lattice_ap70[s];
    }
    sizes.push_back(std::move(size));
  }
  for (const CertifiedHost& host : result.hosts) {
    auto certificates = nlohmann::json::array();
    for (const Certificate& c : host.sizes) {
      certificates.push_back(
          {{"known_iou", c.with_roof_iou}, {"removed", c.removed}, {"hidden_share", c.hidden_share}});
      if (!settings.adversaries.empty()) certificates.back()["attacked_iou"] = c.attacked_iou;
      if (settings.with_lattice)
        certificates.back().update({{"lattice_iou", c.lattice_iou}, {"covered", c.covered}});
      if (settings.with_lattice && settings.whole_lattice)
        certificates.back()["survived_iou"] = c.survived_iou;
    }
    outcomes.push_back({{"frame", host.id.frame},
                        {"label", host.id.label},
                        {"track", host.track},
                        {"range", host.range},
                        {"clean_iou", host.clean_iou},
                        {"control_iou", host.control_iou},
                        {"sizes", certificates}});
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
