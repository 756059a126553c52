#include "scene/unit_finder.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <map>
#include <numbers>
#include <numeric>
#include <unsupported/Eigen/FFT>

#include "base/error.h"
#include "base/intervals.h"
#include "base/sizes.h"
#include "base/types.h"
#include "scene/occlusion.h"

namespace mirage {
namespace {

constexpr double kTurn = 2 * std::numbers::pi;
constexpr std::size_t kMinHits = 2000;       // of all sweeps
constexpr std::size_t kMinBeamReturns = 30;  // hits that prove a beam
constexpr std::size_t kMinBeams = 4, kMaxBeams = 256;
constexpr double kEnoughOnRays = 0.95;
constexpr double kOwnCar = 1;  // m: nearer returns are the recording car's own

double floor_mod(double value, double modulus) {
  return value - modulus * std::floor(value / modulus);
}

double median_of(std::vector<double> values) {
  return lower_quantile(std::move(values), 0.5);
}

/// A return, in `velo` and in the unit's frame.
struct UnitHit {
  Vec3d p_velo, p = Vec3d::Zero();
  int sweep = 0, beam = -1;
  double phase = 0;  ///< of the turn, at the return
  double rho = 0;
};

/// The unit's mount, the same in all sweeps, and its motion within each.
struct UnitPose {
  Transform velo_from_lidar = Transform::Identity();
  std::vector<SweepMotion> motions;
};

void place_hits(std::vector<UnitHit>& hits, const UnitPose& pose) {
  const Transform lidar_from_velo = pose.velo_from_lidar.inverse();
  for (UnitHit& hit : hits) {
    hit.p = pose.motions[as_size(hit.sweep)].seen(lidar_from_velo * hit.p_velo, hit.phase);
    hit.rho = std::max(hit.p.head<2>().norm(), 1e-3);
  }
}

double elevation_of(const UnitHit& hit) {
  return std::atan2(hit.p.z(), hit.rho);
}

// ---------------------------------------------------------------------------------------------- which beam

/// Candidates for the azimuth at which sweeps begin: where neighbours in the file most often belong to
/// different beams and, if there is a wide gap, its middle. `seen`: the angle outside the widest gap.
std::vector<double> cuts_of(const std::vector<double>& azimuths, const std::vector<double>& elevations,
                            double& seen) {
  constexpr int kBins = 720;
  std::vector<int> counts(kBins), changes(kBins);
  const auto bin_of = [&](double azimuth) {
    return static_cast<std::size_t>(floor_mod(azimuth, kTurn) / kTurn * kBins) % kBins;
  };
  for (std::size_t i = 0; i < azimuths.size(); ++i) {
    ++counts[bin_of(azimuths[i])];
    if (i > 0 && std::abs(wrap_angle(azimuths[i] - azimuths[i - 1])) < 5 * kDegree &&
        std::abs(elevations[i] - elevations[i - 1]) > 0.1 * kDegree)
      ++changes[bin_of(azimuths[i])];
  }
  int gap = 0, widest = 0, end = 0;
  for (int b = 0; b < 2 * kBins; ++b) {
    gap = counts[as_size(b % kBins)] == 0 ? gap + 1 : 0;
    if (gap > widest && gap <= kBins) widest = gap, end = b + 1;
  }
  seen = kTurn * (kBins - widest) / kBins;
  const auto most = std::max_element(changes.begin(), changes.end()) - changes.begin();
  std::vector<double> cuts{kTurn * (static_cast<double>(most) - 0.5) / kBins};
  if (widest > kBins / 36) cuts.push_back(kTurn * (end - widest / 2.0) / kBins);
  return cuts;
}

/// Numbers the runs of one beam in a sweep written beam by beam. A new run starts where the azimuth falls
/// back or jumps (the next beam may begin far after this one's end). Empty for another order.
std::vector<int> runs_in_order(const std::vector<double>& azimuths, const std::vector<double>& elevations,
                               double cut) {
  constexpr double kSame = 0.06 * kDegree, kBack = 5 * kDegree, kLeap = 4 * kDegree;
  std::vector<double> changes;
  std::size_t forward = 0, backward = 0;
  for (std::size_t i = 1; i < azimuths.size(); ++i) {
    changes.push_back(std::abs(elevations[i] - elevations[i - 1]));
    const double by = wrap_angle(azimuths[i] - azimuths[i - 1]);
    if (std::abs(by) < 2 * kDegree) ++(by > 0 ? forward : backward);
  }
  if (median_of(changes) > kSame) return {};
  std::vector<int> runs(azimuths.size());
  double before = 0;
  for (std::size_t i = 0; i < azimuths.size(); ++i) {
    const double turned = floor_mod((forward > backward ? 1 : -1) * (azimuths[i] - cut), kTurn);
    runs[i] = i == 0 ? 0 : runs[i - 1] + (turned < before - kBack || turned > before + kLeap);
    before = turned;
  }
  return runs;
}

/// Elevations (rad) at which hits beyond `nearest` (m) pile up, from the top down, at the resolution that
/// best separates them.
std::vector<double> piles(const std::vector<UnitHit>& hits, double nearest) {
  constexpr double kFine = 0.005 * kDegree, kSpan = 90 * kDegree;
  const auto bins = static_cast<std::size_t>(kSpan / kFine);
  std::vector<double> fine(bins);
  for (const UnitHit& hit : hits)
    if (hit.p.norm() >= nearest && std::abs(elevation_of(hit)) < kSpan / 2)
      fine[static_cast<std::size_t>((elevation_of(hit) + kSpan / 2) / kFine)] += 1;
  std::vector<double> best;
  double most = 0;
  for (const double width : {0.02, 0.04, 0.08, 0.16}) {
    const auto reach = static_cast<std::ptrdiff_t>(width * kDegree / kFine);
    std::vector<double> smooth(bins);
    for (std::size_t b = 0; b < bins; ++b) {
      if (fine[b] == 0) continue;
      for (std::ptrdiff_t k = -2 * reach; k <= 2 * reach; ++k) {
        const auto to = static_cast<std::ptrdiff_t>(b) + k;
        if (to >= 0 && to < static_cast<std::ptrdiff_t>(bins))
          smooth[as_size(to)] +=
              fine[b] * std::exp(-2 * std::pow(static_cast<double>(k) / static_cast<double>(reach), 2));
      }
    }
    // Peaks with a valley of less than half on both sides.
    std::vector<std::size_t> peaks;
    double valley = 0;
    std::size_t peak = 0;
    bool rising = true;
    for (std::size_t b = 0; b < bins; ++b) {
      if (rising) {
        if (smooth[b] > smooth[peak]) peak = b;
        if (smooth[b] < 0.5 * smooth[peak] && smooth[peak] >= kMinBeamReturns / 2.0)
          peaks.push_back(peak), valley = smooth[b], rising = false;
        else if (smooth[b] == 0)
          peak = b;
      } else {
        valley = std::min(valley, smooth[b]);
        if (smooth[b] > 2 * valley + 1) peak = b, rising = true;
      }
    }
    double inside = 0, all = 0;
    for (const double count : fine) all += count;
    for (const std::size_t at : peaks)
      for (std::ptrdiff_t k = -reach; k <= reach; ++k)
        if (const auto to = static_cast<std::ptrdiff_t>(at) + k;
            to >= 0 && to < static_cast<std::ptrdiff_t>(bins))
          inside += fine[as_size(to)];
    const double spread = 2 * width * kDegree * static_cast<double>(peaks.size());
    // Share of the hits in the peaks, less the share expected of an even spread.
    const double score = all > 0 ? inside / all - spread / (40 * kDegree) : 0;
    if (peaks.size() < kMaxBeams && score > most) {
      most = score;
      best.clear();
      for (const std::size_t at : peaks) best.push_back(-kSpan / 2 + (static_cast<double>(at) + 0.5) * kFine);
    }
  }
  std::reverse(best.begin(), best.end());
  return best;
}

/// Angle by which the hit misses the line.
double angle_off(const BeamLine& line, const UnitHit& hit) {
  return (hit.p.z() - line.at(hit.rho)) / std::hypot(1.0, line.slope) / hit.p.norm();
}

/// The line of one beam's hits: over heights near `usual` (m), the line with the most hits on it. Hits at
/// equal distances don't show the height; it is then `usual`.
BeamLine line_of(const std::vector<const UnitHit*>& hits, double usual) {
  constexpr double kOn = 0.03 * kDegree, kReach = 0.3, kStep = 0.015, kUnusual = 0.2;
  constexpr std::size_t kEnough = 400;
  BeamLine best;
  double most = -1;
  for (double height = usual - kReach; height <= usual + kReach; height += kStep) {
    std::vector<double> slopes;
    for (std::size_t i = 0; i < hits.size(); i += hits.size() / kEnough + 1)
      slopes.push_back((hits[i]->p.z() - height) / hits[i]->rho);
    const BeamLine line{height, median_of(slopes)};
    double on = 0;
    for (std::size_t i = 0; i < hits.size(); i += hits.size() / kEnough + 1)
      on += 1 / (1 + std::pow(angle_off(line, *hits[i]) / kOn, 2));
    on = on / static_cast<double>(slopes.size()) - kUnusual * std::abs(height - usual);
    if (on > most) most = on, best = line;
  }
  for (int round = 0; round < 8; ++round) {  // to convergence
    Eigen::Matrix2d normal = Eigen::Vector2d(std::pow(kOn / kReach, 2), 0).asDiagonal();
    Eigen::Vector2d right = normal * Eigen::Vector2d(best.height, 0);
    const double cosine = 1 / std::hypot(1.0, best.slope);
    for (const UnitHit* hit : hits) {
      const double per_metre = cosine / hit->p.norm(),
                   weight = 1 / (1 + std::pow(angle_off(best, *hit) / kOn, 2));
      const Eigen::Vector2d row = per_metre * Eigen::Vector2d(1, hit->rho);
      normal += weight * row * row.transpose();
      right += weight * row * per_metre * hit->p.z();
    }
    const Eigen::Vector2d solved = normal.ldlt().solve(right);
    best = {solved[0], solved[1]};
  }
  return best;
}

/// Sorts lines from the top down.
void sort_lines(std::vector<BeamLine>& lines) {
  std::sort(lines.begin(), lines.end(), [](const auto& a, const auto& b) { return a.slope > b.slope; });
}

void assign_beams(std::vector<UnitHit>& hits, const std::vector<BeamLine>& lines) {
  for (UnitHit& hit : hits) hit.beam = static_cast<int>(nearest_line(lines, hit.rho, hit.p.z()));
}

/// Share of the hits that lie on their beam.
double on_beams(const std::vector<UnitHit>& hits, const std::vector<BeamLine>& lines) {
  constexpr double kOn = 0.05 * kDegree;
  const auto on = std::count_if(hits.begin(), hits.end(), [&](const UnitHit& hit) {
    return std::abs(angle_off(lines[as_size(hit.beam)], hit)) < kOn;
  });
  return static_cast<double>(on) / static_cast<double>(hits.size());
}

/// Robust Gauss–Newton on all lines and the pose jointly: hits beyond `nearest` (m) are drawn to their
/// nearest beam. `tilts`: also the tilt; `moves`: also each sweep's own drift.
void refine(std::vector<UnitHit>& hits, std::vector<BeamLine>& lines, UnitPose& pose, bool tilts, bool moves,
            double nearest, double first_scale) {
  constexpr double kScale = 0.02 * kDegree;
  constexpr int kRounds = 20;
  constexpr std::size_t kEnough = 60000;
  const std::size_t every = (hits.size() / kEnough) | 1;  // odd: files cycle through an even number of beams
  std::vector<UnitHit> some;
  for (std::size_t at = 0; at < hits.size(); at += every) some.push_back(hits[at]);
  const int sweeps = static_cast<int>(pose.motions.size()), shared = tilts ? 4 : 0,
            count = shared + (moves ? 6 * sweeps : 0);
  for (int round = 0; round < kRounds; ++round) {
    place_hits(some, pose);
    assign_beams(some, lines);
    const double scale =
        std::max(kScale, first_scale * std::pow(kScale / first_scale, round / (0.6 * kRounds)));
    const auto beams = lines.size();
    std::vector<Eigen::Matrix2d> own(beams, Eigen::Matrix2d::Zero());
    std::vector<Eigen::MatrixXd> mixed(beams, Eigen::MatrixXd::Zero(2, count));
    std::vector<Eigen::Vector2d> own_right(beams, Eigen::Vector2d::Zero());
    Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(count, count);
    Eigen::VectorXd right = Eigen::VectorXd::Zero(count);
    for (const UnitHit& hit : some) {
      if (hit.p.norm() < nearest) continue;
      const auto b = as_size(hit.beam);
      const double off = angle_off(lines[b], hit), weight = 1 / (1 + std::pow(off / scale, 2));
      const double per_metre = 1 / std::hypot(1.0, lines[b].slope) / hit.p.norm();
      // off + row · globals − per_metre (1, ρ) · line = 0
      const Eigen::Vector2d beam_row = per_metre * Eigen::Vector2d(1, hit.rho);
      own[b] += weight * beam_row * beam_row.transpose();
      own_right[b] += weight * off * beam_row;
      if (count == 0) continue;
      const Vec3d outward(hit.p.x() / hit.rho, hit.p.y() / hit.rho, 0);
      const Vec3d up = per_metre * (Vec3d::UnitZ() - lines[b].slope * outward);  // change of `off` per metre
      std::array<std::pair<int, double>, 10> row;  // the globals on which the hit depends
      std::size_t entries = 0;
      if (tilts) {  // the point turns by −w × p and shifts by −o
        row[entries++] = {0, -up.dot(Vec3d::UnitX().cross(hit.p))};
        row[entries++] = {1, -up.dot(Vec3d::UnitY().cross(hit.p))};
        row[entries++] = {2, -up.x()};
        row[entries++] = {3, -up.y()};
      }
      if (moves)
        for (int i = 0; i < 3; ++i) {
          row[entries++] = {shared + 6 * hit.sweep + i, -up[i]};
          row[entries++] = {shared + 6 * hit.sweep + 3 + i, -up[i] * hit.phase};
        }
      for (std::size_t i = 0; i < entries; ++i) {
        const auto& [column, value] = row[i];
        mixed[b].col(column) -= weight * value * beam_row;
        right[column] -= weight * off * value;
        for (std::size_t k = 0; k < entries; ++k)
          normal(column, row[k].first) += weight * value * row[k].second;
      }
    }
    // Weak priors hold parameters that hits do not determine.
    for (int i = 0; i < count; ++i) normal(i, i) += std::pow(scale / (i < shared && i < 2 ? 0.1 : 0.5), 2);
    std::vector<Eigen::Matrix2d> inverse(beams);
    for (std::size_t b = 0; b < beams; ++b) {
      own[b](0, 0) += std::pow(scale / 0.3, 2);
      own_right[b][0] -= std::pow(scale / 0.3, 2) * lines[b].height;
      own[b](1, 1) += 1e-12;
      inverse[b] = own[b].inverse();
      if (count == 0) continue;
      normal -= mixed[b].transpose() * inverse[b] * mixed[b];
      right -= mixed[b].transpose() * inverse[b] * own_right[b];
    }
    const Eigen::VectorXd step = count > 0 ? Eigen::VectorXd(normal.ldlt().solve(right)) : Eigen::VectorXd();
    for (std::size_t b = 0; b < beams; ++b) {
      Eigen::Vector2d moved = own_right[b];
      if (count > 0) moved -= mixed[b] * step;
      moved = inverse[b] * moved;
      lines[b].height += moved[0], lines[b].slope += moved[1];
    }
    if (tilts) {
      Transform by = Transform::Identity();
      by.linear() = (Eigen::AngleAxisd(step[0], Vec3d::UnitX()) * Eigen::AngleAxisd(step[1], Vec3d::UnitY()))
                        .toRotationMatrix();
      by.translation() = Vec3d(step[2], step[3], 0);
      pose.velo_from_lidar = pose.velo_from_lidar * by;
    }
    if (moves)
      for (int s = 0; s < sweeps; ++s) {
        SweepMotion& motion = pose.motions[as_size(s)];
        motion.start += step.segment<3>(shared + 6 * s);
        motion.turn += step.segment<3>(shared + 6 * s + 3);
      }
    sort_lines(lines);
  }
  place_hits(hits, pose);
  assign_beams(hits, lines);
}

/// The lines of runs in file order, those with the most hits first: a run lies on a line found before, or
/// yields a new one. `on`: hits of runs that one line explains.
std::vector<BeamLine> lines_in_order(const std::vector<UnitHit>& hits, const std::vector<int>& runs,
                                     std::size_t& on) {
  constexpr double kOneBeam = 0.05 * kDegree, kAnother = 0.07 * kDegree;
  std::map<std::pair<int, int>, std::vector<const UnitHit*>> groups;
  for (std::size_t i = 0; i < hits.size(); ++i) groups[{hits[i].sweep, runs[i]}].push_back(&hits[i]);
  std::vector<const std::vector<const UnitHit*>*> order;
  for (const auto& [key, members] : groups)
    if (members.size() >= kMinBeamReturns) order.push_back(&members);
  std::stable_sort(order.begin(), order.end(),
                   [](const auto* a, const auto* b) { return a->size() > b->size(); });
  const auto off_median = [](const std::vector<const UnitHit*>& run, const auto& line_of_hit) {
    std::vector<double> off;
    for (const UnitHit* hit : run) off.push_back(std::abs(angle_off(line_of_hit(*hit), *hit)));
    return median_of(off);
  };
  std::vector<BeamLine> lines;
  on = 0;
  for (const auto* run : order) {
    const auto nearest = [&](const UnitHit& hit) { return lines[nearest_line(lines, hit.rho, hit.p.z())]; };
    if (!lines.empty() && off_median(*run, nearest) < kAnother) {
      on += run->size();
      continue;
    }
    std::vector<double> heights;
    for (const BeamLine& other : lines) heights.push_back(other.height);
    const BeamLine line = line_of(*run, median_of(heights));
    if (off_median(*run, [&](const UnitHit&) { return line; }) > kOneBeam) continue;  // two beams, or no beam
    on += run->size();
    lines.push_back(line);
    sort_lines(lines);
  }
  return lines;
}

/// Drops lines with few hits, and merges duplicates.
void clean_lines(std::vector<UnitHit>& hits, std::vector<BeamLine>& lines) {
  if (lines.empty()) return;
  assign_beams(hits, lines);
  std::vector<std::size_t> counts(lines.size());
  for (const UnitHit& hit : hits) {
    const auto b = as_size(hit.beam);
    counts[b] += std::abs(angle_off(lines[b], hit)) < 0.1 * kDegree;
  }
  std::vector<BeamLine> kept;
  std::vector<std::size_t> of_kept;
  for (std::size_t b = 0; b < lines.size(); ++b) {
    if (counts[b] < kMinBeamReturns) continue;
    const double apart = kept.empty() ? 1 : std::atan(kept.back().slope) - std::atan(lines[b].slope);
    if (apart < 0.03 * kDegree) {
      if (counts[b] > of_kept.back()) kept.back() = lines[b];
      of_kept.back() += counts[b];
      continue;
    }
    kept.push_back(lines[b]);
    of_kept.push_back(counts[b]);
  }
  // Drops lines that stray hits drew between two beams, or beside one.
  const auto apart = [&](std::size_t i, std::size_t k) {
    return std::atan(kept[i].slope) - std::atan(kept[k].slope);
  };
  std::vector<BeamLine> sure;
  for (std::size_t b = 0; b < kept.size(); ++b) {
    constexpr std::size_t kNeighbours = 4;
    std::vector<double> gaps;
    for (std::size_t i = b > kNeighbours ? b - kNeighbours : 0;
         i + 1 < std::min(kept.size(), b + kNeighbours + 1); ++i)
      gaps.push_back(apart(i, i + 1));
    const double usual = median_of(gaps), above = b > 0 ? apart(b - 1, b) : kTurn,
                 below = b + 1 < kept.size() ? apart(b, b + 1) : kTurn, closest = std::min(above, below);
    const bool between = b > 0 && b + 1 < kept.size();
    if (between && closest < 0.6 * usual && 10 * of_kept[b] < std::min(of_kept[b - 1], of_kept[b + 1]))
      continue;
    if (closest < 0.1 * usual && of_kept[b] < of_kept[above < below ? b - 1 : b + 1]) continue;
    sure.push_back(kept[b]);
  }
  lines = std::move(sure);
  if (!lines.empty()) assign_beams(hits, lines);
}

// ------------------------------------------------------------------------------------------ when it fires

/// Azimuths (rad) of far hits, by beam and sweep.
using BeamAzimuths = std::vector<std::vector<std::vector<double>>>;

BeamAzimuths azimuths_of(const std::vector<UnitHit>& hits, const std::vector<double>& laterals,
                         std::size_t sweeps, double nearest) {
  BeamAzimuths all(laterals.size(), std::vector<std::vector<double>>(sweeps));
  for (const UnitHit& hit : hits) {
    if (hit.rho < nearest) continue;
    const auto b = as_size(hit.beam);
    const double sideways = std::asin(std::clamp(laterals[b] / hit.rho, -1.0, 1.0));
    all[b][as_size(hit.sweep)].push_back(std::atan2(hit.p.y(), hit.p.x()) - sideways);
  }
  for (auto& beam : all)
    for (auto& sweep : beam) std::sort(sweep.begin(), sweep.end());
  return all;
}

/// Mean step between consecutive firings (rad); 0: not visible.
double mean_step(const BeamAzimuths& all) {
  std::vector<double> steps;
  for (const auto& beam : all)
    for (const auto& sweep : beam)
      for (std::size_t i = 1; i < sweep.size(); ++i)
        if (const double by = sweep[i] - sweep[i - 1]; by > 0.01 * kDegree && by < 3 * kDegree)
          steps.push_back(by);
  if (steps.size() < kMinHits / 4) return 0;
  const double usual = median_of(steps);
  double sum = 0, count = 0;
  for (const double by : steps)
    if (by > 0.3 * usual && by < 1.45 * usual) sum += by, ++count;
  return sum / count;
}

std::complex<double> resultant(const std::vector<double>& azimuths, double step) {
  std::complex<double> sum = 0;
  for (const double azimuth : azimuths) sum += std::polar(1.0, kTurn * azimuth / step);
  return sum;
}

/// A far hit, for finding its beam's firings.
struct FarHit {
  double azimuth = 0, rho = 0;
  int sweep = 0;
  /// The firing's azimuth, for a ray that starts `lateral` (m) beside the axis.
  double firing(double lateral) const { return azimuth - std::asin(std::clamp(lateral / rho, -1.0, 1.0)); }
};

/// For each beam, the hits further than `nearest` (m) from the axis.
std::vector<std::vector<FarHit>> hits_beyond(const std::vector<UnitHit>& hits, std::size_t beams,
                                             double nearest) {
  std::vector<std::vector<FarHit>> all(beams);
  for (const UnitHit& hit : hits)
    if (hit.rho > nearest)
      all[as_size(hit.beam)].push_back({std::atan2(hit.p.y(), hit.p.x()), hit.rho, hit.sweep});
  return all;
}

/// Agreement of the beam's firings with `per_turn` steps a turn, all sweeps on one grid (`together`) or each
/// on its own: 1 exact, 0 none.
double coherence(const std::vector<FarHit>& hits, double lateral, double per_turn, bool together) {
  std::map<int, std::complex<double>> sums;
  for (const FarHit& hit : hits)
    sums[together ? 0 : hit.sweep] += std::polar(1.0, per_turn * hit.firing(lateral));
  double sum = 0;
  for (const auto& [sweep, own] : sums) sum += std::abs(own);
  return sum / std::max<double>(1, static_cast<double>(hits.size()));
}

/// coherence() for every whole number of steps a turn.
std::vector<double> coherences(const std::vector<FarHit>& hits, double lateral) {
  constexpr std::size_t kBins = 360000;
  std::vector<double> counts(kBins);
  for (const FarHit& hit : hits)
    counts[static_cast<std::size_t>(floor_mod(hit.firing(lateral), kTurn) / kTurn * kBins) % kBins] += 1;
  Eigen::FFT<double> fft;
  std::vector<std::complex<double>> spectrum;
  fft.fwd(spectrum, counts);
  std::vector<double> values(kBins / 2);
  for (std::size_t k = 0; k < values.size(); ++k)
    values[k] = std::abs(spectrum[k]) / static_cast<double>(hits.size());
  return values;
}

/// Pitch (rad) of the azimuth grid on which all sweeps' firings of a beam lie: about `step` if firings are
/// evenly spaced, otherwise an encoder's finer pitch. 0: no grid.
double grid_of(const std::vector<UnitHit>& hits, std::size_t beams, double step) {
  constexpr double kEven = 0.65, kCoherent = 0.5, kClearly = 0.1, kFar = 8, kFinest = 0.02 * kDegree;
  constexpr double kMaxLateral = 0.06, kLateralStep = 0.004;
  constexpr std::size_t kLooked = 4;  // beams, those with the most hits
  std::vector<std::vector<FarHit>> all = hits_beyond(hits, beams, kFar);
  std::ranges::stable_sort(all, std::greater<>(), [](const auto& of) { return of.size(); });
  if (all.size() > kLooked) all.resize(kLooked);
  std::erase_if(all, [](const auto& of) { return of.size() < kMinBeamReturns; });
  if (all.empty()) return 0;
  std::vector<double> laterals(all.size());
  const auto mean = [&](double per_turn, bool together) {
    double sum = 0;
    for (std::size_t b = 0; b < all.size(); ++b) sum += coherence(all[b], laterals[b], per_turn, together);
    return sum / static_cast<double>(all.size());
  };
  const auto best_near = [&](double low, double high, double by, bool together) {
    std::pair<double, double> best{-1, low};
    for (double per_turn = low; per_turn <= high; per_turn += by)
      best = std::max(best, {mean(per_turn, together), per_turn});
    return best;
  };
  const auto grid = [](double per_turn) {
    const double whole = std::round(per_turn);
    return kTurn / (std::abs(per_turn - whole) < 0.03 ? whole : per_turn);
  };
  const double usual = kTurn / step;
  const auto [even, at] = best_near(0.98 * usual, 1.02 * usual, 0.25, false);
  const auto first = static_cast<std::size_t>(1.15 * usual),
             last = std::max(first + 1, static_cast<std::size_t>(kTurn / kFinest));
  std::vector<double> sums(last);
  for (std::size_t b = 0; b < all.size(); ++b) {
    double most = -1;
    std::vector<double> kept;
    for (double lateral = -kMaxLateral; lateral <= kMaxLateral; lateral += kLateralStep) {
      std::vector<double> values = coherences(all[b], lateral);
      const double value = *std::max_element(values.begin() + static_cast<std::ptrdiff_t>(first),
                                             values.begin() + static_cast<std::ptrdiff_t>(last));
      if (value > most) most = value, laterals[b] = lateral, kept = std::move(values);
    }
    for (std::size_t k = 0; k < last; ++k) sums[k] += kept[k];
  }
  auto most =
      as_size(std::max_element(sums.begin() + static_cast<std::ptrdiff_t>(first), sums.end()) - sums.begin());
  for (const std::size_t part : {3u, 2u})  // multiples of a fine grid's steps a turn look like grids, too
    if (most / part > first && sums[most / part] > 0.8 * sums[most]) {
      most /= part;
      break;
    }
  const auto [value, per_turn] =
      best_near(static_cast<double>(most) - 1, static_cast<double>(most) + 1, 0.02, true);
  // Firings that alternate between two and three places of a fine grid look half even.
  if (value > std::max(kCoherent, even + kClearly)) return grid(per_turn);
  if (even < kEven) return 0;
  std::fill(laterals.begin(), laterals.end(), 0.0);
  const auto [together, steps] = best_near(at - 2, at + 2, 0.02, true);
  return together > kEven ? grid(steps) : 0;
}

/// Lateral offsets (m) of the beams' rays: those that best put near and far azimuths on the grid.
std::vector<double> laterals_of(const std::vector<UnitHit>& hits, std::size_t beams, double grid) {
  constexpr double kMax = 0.06, kStep = 0.002, kNear = 2, kGain = 0.02;
  const std::vector<std::vector<FarHit>> seen = hits_beyond(hits, beams, kNear);
  std::vector<double> laterals(beams);
  for (std::size_t b = 0; b < beams; ++b) {
    const auto coherent = [&](double lateral) {
      std::complex<double> sum = 0;
      for (const FarHit& hit : seen[b]) sum += std::polar(1.0, kTurn * hit.firing(lateral) / grid);
      return std::abs(sum) / std::max<double>(1, static_cast<double>(seen[b].size()));
    };
    double best = coherent(0) + kGain;
    for (double lateral = -kMax; lateral <= kMax; lateral += kStep)
      if (const double value = coherent(lateral); value > best) best = value, laterals[b] = lateral;
  }
  return laterals;
}

/// Phase (rad, within half a step) of each beam's azimuths on a grid common to all sweeps.
std::vector<double> phases_on_grid(const BeamAzimuths& all, double grid) {
  std::vector<double> phases;
  for (const auto& beam : all) {
    std::complex<double> sum = 0;
    for (const auto& sweep : beam) sum += resultant(sweep, grid);
    phases.push_back(std::arg(sum) / kTurn * grid);
  }
  return phases;
}

/// Adds to the phases the whole grid steps that align the beams' firing patterns.
void align_patterns(const BeamAzimuths& all, double grid, std::vector<double>& phases) {
  constexpr double kWidestTurn = 12 * kDegree;
  const auto steps = as_size(std::lround(kTurn / grid));
  const int most = static_cast<int>(kWidestTurn / grid);
  const std::size_t sweeps = all.front().size();
  std::vector<std::vector<double>> pattern(sweeps, std::vector<double>(steps));
  const auto place = [&](double azimuth, double phase) {
    return std::lround(floor_mod(azimuth - phase, kTurn) / grid);
  };
  std::vector<std::size_t> order(all.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  const auto size_of = [&](std::size_t b) {
    return std::accumulate(all[b].begin(), all[b].end(), std::size_t{0},
                           [](std::size_t sum, const auto& sweep) { return sum + sweep.size(); });
  };
  std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) { return size_of(a) > size_of(b); });
  // The first beams are aligned with few others: later rounds align each with all others.
  constexpr int kRounds = 3;
  const auto count = [&](std::size_t b, double by) {
    for (std::size_t s = 0; s < sweeps; ++s)
      for (const double azimuth : all[b][s]) pattern[s][as_size(place(azimuth, phases[b])) % steps] += by;
  };
  for (int round = 0; round < kRounds; ++round)
    for (const std::size_t b : order) {
      if (round > 0) count(b, -1);
      int best = 0;
      double most_hits = -1;
      for (int k = 0; k <= 2 * most; ++k) {
        const int lag = k % 2 == 0 ? k / 2 : -(k + 1) / 2;  // the smallest first
        double meets = 0;
        for (std::size_t s = 0; s < sweeps; ++s)
          for (const double azimuth : all[b][s])
            meets +=
                pattern[s][as_size(place(azimuth, phases[b]) - lag + 2 * static_cast<long>(steps)) % steps];
        if (meets > 1.001 * most_hits) most_hits = meets, best = lag;
      }
      phases[b] += best * grid;
      count(b, 1);
    }
}

/// Relative phases of the beams when every sweep begins at another azimuth: the phases common to windows of
/// 10°.
std::vector<double> phases_between(const BeamAzimuths& all, double step) {
  constexpr int kWindows = 36;
  const std::size_t sweeps = all.front().size();
  using Windows = std::vector<std::complex<double>>;
  std::vector<Windows> own(all.size(), Windows(sweeps * kWindows));
  for (std::size_t b = 0; b < all.size(); ++b)
    for (std::size_t s = 0; s < sweeps; ++s)
      for (const double azimuth : all[b][s]) {
        const auto w = static_cast<std::size_t>(floor_mod(azimuth, kTurn) / kTurn * kWindows) % kWindows;
        own[b][s * kWindows + w] += std::polar(1.0, kTurn * azimuth / step);
      }
  std::vector<double> phases(all.size());
  Windows common(sweeps * kWindows);
  for (int round = 0; round < 5; ++round) {
    Windows next(common.size());
    for (std::size_t b = 0; b < all.size(); ++b) {
      std::complex<double> against = 0;
      for (std::size_t w = 0; w < common.size(); ++w) {
        const auto others =
            common[w] - (round > 0 ? own[b][w] * std::polar(1.0, -phases[b] * kTurn / step) : 0);
        if (std::abs(others) > 0) against += own[b][w] * std::conj(others) / std::abs(others);
      }
      if (std::abs(against) > 0) phases[b] = std::arg(against) / kTurn * step;
      for (std::size_t w = 0; w < common.size(); ++w) {
        const auto turned = own[b][w] * std::polar(1.0, -phases[b] * kTurn / step);
        next[w] += turned;
        if (round == 0) common[w] += turned;
      }
    }
    common = next;
  }
  return phases;
}

/// Height (m) of the velo origin over the ground: from the fullest layer of low returns nearby.
double height_over_ground(const std::vector<UnitHit>& hits) {
  constexpr double kMinDistance = 4, kMaxReturnDistance = 20, kLayer = 0.05;
  std::map<long, std::size_t> layers;
  for (const UnitHit& hit : hits)
    if (const double rho = hit.p_velo.head<2>().norm();
        rho > kMinDistance && rho < kMaxReturnDistance && hit.p_velo.z() < -0.5)
      ++layers[std::lround(hit.p_velo.z() / kLayer)];
  if (layers.empty()) return 0;
  const auto fullest = std::max_element(layers.begin(), layers.end(),
                                        [](const auto& a, const auto& b) { return a.second < b.second; });
  return -static_cast<double>(fullest->first) * kLayer;
}

/// The sweep without returns on the recording car.
Sweep without_own_car(const Sweep& sweep) {
  Sweep kept;
  for (const LidarPoint& point : sweep)
    if (point.position().norm() >= kOwnCar) kept.push_back(point);
  return kept;
}

}  // namespace

LidarFit find_unit(const std::vector<Sweep>& sweeps, const std::string& where, const Transform& start) {
  const auto refuse = [&](const std::string& problem) {
    return InputError(where, "sweeps", problem,
                      "give sweeps as the unit recorded them: one turn each, in its own axes, all returns");
  };
  std::vector<UnitHit> hits;
  std::vector<std::vector<int>> runs(2);  // by candidate cut
  UnitPose still{start, {}};
  double seen = 0;
  for (std::size_t s = 0; s < sweeps.size(); ++s) {
    std::vector<Vec3d> points;
    std::vector<double> azimuths, elevations, phases;
    for (const LidarPoint& point : without_own_car(sweeps[s])) {
      const Vec3d p_velo = point.position().cast<double>(), p = start.inverse() * p_velo;
      points.push_back(p);
      azimuths.push_back(std::atan2(p.y(), p.x()));
      elevations.push_back(std::atan2(p.z(), p.head<2>().norm()));
      hits.push_back({p_velo, p, static_cast<int>(s), -1, 0, 0});
    }
    still.motions.push_back(no_motion(points, phases));
    for (std::size_t i = 0; i < phases.size(); ++i) hits[hits.size() - phases.size() + i].phase = phases[i];
    if (points.empty()) continue;
    double width = 0;
    const std::vector<double> cuts = cuts_of(azimuths, elevations, width);
    seen = std::max(seen, width);
    for (std::size_t c = 0; c < runs.size(); ++c) {
      const std::vector<int> order = runs_in_order(azimuths, elevations, cuts[std::min(c, cuts.size() - 1)]);
      runs[c].insert(runs[c].end(), order.begin(), order.end());
    }
  }
  if (hits.size() < kMinHits) throw refuse(fmt::format("{} returns are too few", hits.size()));

  UnitPose pose = still;
  place_hits(hits, pose);
  std::vector<BeamLine> lines;
  std::size_t explained = 0;
  for (std::size_t c = 0; c < runs.size(); ++c) {
    std::size_t on = 0;
    if (runs[c].size() != hits.size() || (c > 0 && runs[c] == runs[0])) continue;
    if (std::vector<BeamLine> found = lines_in_order(hits, runs[c], on); on > explained)
      lines = std::move(found), explained = on;
  }
  constexpr double kOnBeams = 0.99, kFar = 12;  // m
  struct Fit {
    std::vector<BeamLine> lines;
    UnitPose pose;
    double on = 0;
  };
  Fit best{{}, still, 0};
  // Keeps a refinement that explains clearly more than the best so far.
  const auto settle = [&](bool tilts, bool moves, double nearest, double scale) {
    constexpr double kClearly = 0.002;
    clean_lines(hits, lines);
    if (lines.size() < kMinBeams) return;
    refine(hits, lines, pose, tilts, moves, nearest, scale);
    clean_lines(hits, lines);
    if (lines.size() < kMinBeams) return;
    if (const double on = on_beams(hits, lines); on > best.on + kClearly) best = {lines, pose, on};
  };
  const auto restart = [&] {
    pose = still;
    place_hits(hits, pose);
  };
  settle(false, false, 0, 0.1 * kDegree);
  if (best.on < kOnBeams) settle(true, false, 0, 0.2 * kDegree);
  if (best.on < kOnBeams) settle(true, true, 0, 0.2 * kDegree);
  for (const bool moves : {false, true})
    for (const double nearest : {kFar, kFar / 2, 0.0, 0.0}) {
      if (best.on >= kOnBeams) break;
      if (nearest == kFar) restart();
      lines.clear();
      for (const double elevation : piles(hits, nearest)) lines.push_back({0, std::tan(elevation)});
      settle(moves, moves, nearest, 0.2 * kDegree);
    }
  if (best.lines.empty()) throw refuse("their elevations show no beams");
  lines = best.lines;
  pose = best.pose;
  place_hits(hits, pose);
  assign_beams(hits, lines);

  LidarFit found;
  LidarModel& lidar = found.lidar;
  lidar.name = fmt::format("{} beams, found from sweeps", lines.size());
  lidar.velo_from_lidar = pose.velo_from_lidar;
  lidar.rate = 10;
  std::vector<double> laterals(lines.size());
  BeamAzimuths all = azimuths_of(hits, laterals, sweeps.size(), 8);
  const double step = mean_step(all);
  if (step == 0) throw refuse("their azimuths show no firings");
  lidar.azimuth_step = step;
  const double grid = grid_of(hits, lines.size(), step);
  std::vector<double> phases;
  if (grid > 0) {
    laterals = laterals_of(hits, lines.size(), grid);
    all = azimuths_of(hits, laterals, sweeps.size(), 2);
    phases = phases_on_grid(all, grid);
    if (grid < 0.97 * step) {  // not every place of the grid fires
      align_patterns(all, grid, phases);
      lidar.encoder_step = grid;
    } else {
      lidar.azimuth_step = grid;
    }
  } else {
    phases = phases_between(all, step);
  }
  double low = 0, high = 0, farthest = 0;
  for (std::size_t b = 0; b < lines.size(); ++b)
    lidar.beams.push_back({std::atan(lines[b].slope), lines[b].height, laterals[b], phases[b], 0});
  for (const UnitHit& hit : hits) {
    const double azimuth = std::atan2(hit.p.y(), hit.p.x()) - phases[as_size(hit.beam)];
    low = std::min(low, azimuth), high = std::max(high, azimuth);
    farthest = std::max(farthest, hit.p.norm());
  }
  if (seen > kTurn - 15 * kDegree) low = -std::numbers::pi, high = std::numbers::pi;
  const double raster = grid > 0 ? lidar.azimuth_step : 1 * kDegree;
  lidar.azimuth_min = std::max(-std::numbers::pi, std::floor(low / raster) * raster);
  lidar.azimuth_max = std::min(std::numbers::pi, std::ceil(high / raster) * raster);
  if (grid > 0 && lidar.azimuth_min < low)  // keeps to the grid, which half a turn need not fit
    lidar.azimuth_min = std::ceil(lidar.azimuth_min / raster - 1e-9) * raster;
  else if (grid > 0)
    lidar.azimuth_min = std::ceil(-std::numbers::pi / raster) * raster;
  lidar.range_min = kOwnCar;
  lidar.range_max = std::min(1000.0, std::ceil(farthest));
  lidar.height = height_over_ground(hits);
  double on = 0;
  for (const Sweep& whole : sweeps) {
    const Sweep sweep = without_own_car(whole);
    const SweepIndex index(sweep, lidar);
    on += index.assigned_share() * static_cast<double>(sweep.size());
    found.returns += sweep.size();
    found.firings += index.firing_count() / static_cast<double>(sweeps.size());
  }
  found.on_rays = on / static_cast<double>(found.returns);
  if (found.on_rays < kEnoughOnRays)
    throw refuse(fmt::format(
        "no spinning unit explains them: {:.1f} % of the returns lie on a ray of the best ({} beams)",
        100 * found.on_rays, lines.size()));
  return found;
}

}  // namespace mirage
