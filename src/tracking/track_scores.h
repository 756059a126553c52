// How well tracks follow the truth, from similarities of their boxes in [0, 1], frame by frame.
//
// CLEAR MOT (Bernardin and Stiefelhagen, EURASIP Journal on Image and Video Processing 2008), at one least
// similarity. In each frame pairs of the frame before are kept where they still match, the rest is assigned
// for the largest similarity:
//
//   MOTA = 1 − (FN + FP + IDSW) / truths      IDSW: a truth is matched by another track than when it last was
//   MOTP = mean similarity of the matches     fragments: a truth that was matched is again, after a gap
//   mostly tracked: matched in more than 0.8 of its frames; mostly lost: in less than 0.2
//
// HOTA (Luiten et al., International Journal of Computer Vision 129, 2021), over the thresholds α = 0.05,
// 0.10 … 0.95. Pairs are assigned by similarity times how well the two fit over the whole sequence; TPA, FNA
// and FPA of a match c count the frames of its truth and its track in which both, the truth alone, the track
// alone are there:
//
//   DetA = TP / (TP + FN + FP)   AssA = 1/TP Σ_c TPA(c) / (TPA(c) + FNA(c) + FPA(c))   HOTA = √(DetA · AssA)
//
// Both as their authors' evaluation code has them (TrackEval).
#pragma once

#include <Eigen/Core>
#include <nlohmann/json.hpp>
#include <span>
#include <vector>

namespace mirage {

/// Who is there in a frame, and how alike their boxes are.
struct TrackFrame {
  std::vector<int> truths, tracks;  ///< identities, none twice; of several sequences each has its own
  Eigen::MatrixXd similarity;       ///< truths × tracks, in [0, 1]
};

/// See the header.
struct TrackScores {
  int truths = 0, tracks = 0;  ///< boxes over all frames
  int matches = 0, misses = 0, false_positives = 0, switches = 0, fragments = 0;
  int mostly_tracked = 0, mostly_lost = 0, identities = 0;  ///< of `identities` truths
  double mota = 0, motp = 0;
  double hota = 0, deta = 0, assa = 0;  ///< means over α
};

/// Frames in order of time, a sequence after the other. `least`: the similarity of a match of CLEAR MOT.
/// InputError for a similarity of another size than its frame's.
TrackScores score_tracks(std::span<const TrackFrame> frames, double least = 0.5);

/// Every field under its name.
nlohmann::json to_json(const TrackScores& scores);

}  // namespace mirage
