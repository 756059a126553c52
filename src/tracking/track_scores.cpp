#include "tracking/track_scores.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "base/error.h"
#include "tracking/tracker.h"

namespace mirage {
namespace {

constexpr double kTiny = 1e-12;  // a similarity that equals a threshold matches
constexpr int kAlphas = 19;

/// The pairs of positive gain with the largest total.
std::vector<std::pair<int, int>> most_alike(const Eigen::MatrixXd& gain) {
  // A pair without gain costs as much as none: it fills up the assignment and is dropped then.
  auto pairs = assign(-gain);
  std::erase_if(pairs, [&](const auto& pair) { return !(gain(pair.first, pair.second) > kTiny); });
  return pairs;
}

void add_clear(std::span<const TrackFrame> frames, double least, TrackScores& scores) {
  constexpr double kKept = 1000;    // more than all similarities of a frame
  std::map<int, int> last, before;  // the track that matched a truth: ever, and in the frame before
  struct Seen {
    int frames = 0, matched = 0, pieces = 0;
  };
  std::map<int, Seen> seen;
  double similarity = 0;
  for (const TrackFrame& frame : frames) {
    Eigen::MatrixXd gain = frame.similarity;
    for (Eigen::Index t = 0; t < gain.rows(); ++t)
      for (Eigen::Index k = 0; k < gain.cols(); ++k) {
        const auto kept = before.find(frame.truths[static_cast<std::size_t>(t)]);
        const bool same = kept != before.end() && kept->second == frame.tracks[static_cast<std::size_t>(k)];
        gain(t, k) = gain(t, k) < least - kTiny ? 0 : gain(t, k) + (same ? kKept : 0);
      }
    for (const int truth : frame.truths) ++seen[truth].frames;
    std::map<int, int> now;
    for (const auto& [t, k] : most_alike(gain)) {
      const int truth = frame.truths[static_cast<std::size_t>(t)],
                track = frame.tracks[static_cast<std::size_t>(k)];
      const auto earlier = last.find(truth);
      scores.switches += earlier != last.end() && earlier->second != track;
      Seen& of = seen[truth];
      of.pieces += !before.contains(truth);
      ++of.matched;
      now[truth] = last[truth] = track;
      similarity += frame.similarity(t, k);
    }
    const int matched = static_cast<int>(now.size());
    scores.matches += matched;
    scores.truths += static_cast<int>(frame.truths.size());
    scores.tracks += static_cast<int>(frame.tracks.size());
    before = std::move(now);
  }
  scores.misses = scores.truths - scores.matches;
  scores.false_positives = scores.tracks - scores.matches;
  for (const auto& [truth, of] : seen) {
    scores.fragments += std::max(0, of.pieces - 1);
    const double share = static_cast<double>(of.matched) / of.frames;
    scores.mostly_tracked += share > 0.8;
    scores.mostly_lost += share < 0.2;
  }
  scores.identities = static_cast<int>(seen.size());
  if (scores.truths > 0)
    scores.mota =
        1 - static_cast<double>(scores.misses + scores.false_positives + scores.switches) / scores.truths;
  if (scores.matches > 0) scores.motp = similarity / scores.matches;
}

void add_hota(std::span<const TrackFrame> frames, TrackScores& scores) {
  using Pair = std::pair<int, int>;
  std::map<int, double> truth_frames, track_frames;
  std::map<Pair, double> together;  // of truth and track: Σ similarity over all that either is similar to
  for (const TrackFrame& frame : frames) {
    for (const int truth : frame.truths) ++truth_frames[truth];
    for (const int track : frame.tracks) ++track_frames[track];
    const Eigen::MatrixXd& s = frame.similarity;
    const Eigen::VectorXd by_truth = s.rowwise().sum();
    const Eigen::RowVectorXd by_track = s.colwise().sum();
    for (Eigen::Index t = 0; t < s.rows(); ++t)
      for (Eigen::Index k = 0; k < s.cols(); ++k)
        if (const double all = by_truth[t] + by_track[k] - s(t, k); s(t, k) > 0 && all > kTiny)
          together[{frame.truths[static_cast<std::size_t>(t)], frame.tracks[static_cast<std::size_t>(k)]}] +=
              s(t, k) / all;
  }
  const auto jaccard = [&](const Pair& pair, double both) {
    return both / (truth_frames.at(pair.first) + track_frames.at(pair.second) - both);
  };
  std::array<std::map<Pair, double>, kAlphas> matches;
  std::array<double, kAlphas> hits{};
  for (const TrackFrame& frame : frames) {
    Eigen::MatrixXd gain = frame.similarity;
    const auto pair_of = [&](Eigen::Index t, Eigen::Index k) {
      return Pair(frame.truths[static_cast<std::size_t>(t)], frame.tracks[static_cast<std::size_t>(k)]);
    };
    for (Eigen::Index t = 0; t < gain.rows(); ++t)
      for (Eigen::Index k = 0; k < gain.cols(); ++k)
        if (gain(t, k) > 0) gain(t, k) *= jaccard(pair_of(t, k), together.at(pair_of(t, k)));
    for (const auto& [t, k] : most_alike(gain))
      for (int a = 0; a < kAlphas; ++a)
        if (frame.similarity(t, k) >= 0.05 * (a + 1) - kTiny) {
          ++matches[static_cast<std::size_t>(a)][pair_of(t, k)];
          ++hits[static_cast<std::size_t>(a)];
        }
  }
  for (std::size_t a = 0; a < kAlphas; ++a) {
    double association = 0;
    for (const auto& [pair, count] : matches[a]) association += count * jaccard(pair, count);
    const double all = scores.truths + scores.tracks - hits[a];
    const double deta = all > 0 ? hits[a] / all : 0, assa = association / std::max(1.0, hits[a]);
    scores.deta += deta / kAlphas;
    scores.assa += assa / kAlphas;
    scores.hota += std::sqrt(deta * assa) / kAlphas;
  }
}

}  // namespace

TrackScores score_tracks(std::span<const TrackFrame> frames, double least) {
  for (const TrackFrame& frame : frames)
    if (frame.similarity.rows() != static_cast<Eigen::Index>(frame.truths.size()) ||
        frame.similarity.cols() != static_cast<Eigen::Index>(frame.tracks.size()))
      throw InputError("tracks", "similarity", "is not of as many rows as truths and columns as tracks",
                       "give one for each pair");
  TrackScores scores;
  add_clear(frames, least, scores);
  add_hota(frames, scores);
  return scores;
}

nlohmann::json to_json(const TrackScores& s) {
  return {{"truths", s.truths},
          {"tracks", s.tracks},
          {"matches", s.matches},
          {"misses", s.misses},
          {"false_positives", s.false_positives},
          {"switches", s.switches},
          {"fragments", s.fragments},
          {"mostly_tracked", s.mostly_tracked},
          {"mostly_lost", s.mostly_lost},
          {"identities", s.identities},
          {"mota", s.mota},
          {"motp", s.motp},
          {"hota", s.hota},
          {"deta", s.deta},
          {"assa", s.assa}};
}

}  // namespace mirage
