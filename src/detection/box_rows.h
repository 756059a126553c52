// The answers of detectors outside the program: rows of boxes with their logits.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "detection/detector.h"

namespace mirage {

/// As arrays, row-major. Columns in the picture: left, top, right, bottom (pixels). Else in the ego frame, m
/// and rad: x, y, length, width, yaw; or x, y, z of the centre, length, width, height, yaw; or these and the
/// velocity's x and y (m/s).
struct RawBoxes {
  const float* boxes = nullptr;
  const float* logits = nullptr;
  std::size_t count = 0, columns = 0;
  std::span<const std::int32_t> classes = {};  ///< of each row, in Capabilities::types; empty: all the first
};

/// Which of the rows became proposals, so that their gradients find the way back.
class BoxRows {
 public:
  static bool knows(std::size_t columns, bool in_picture);
  /// "give boxes [M,5] …": for messages.
  static const char* guide();

  /// Those with a score over the threshold, in their order. Boxes in the picture end at its border
  /// (width × height). InputError naming `who` for what is no box (check_proposals), or of no class.
  std::vector<Detection> proposals(const RawBoxes& raw, const Capabilities& can, double score_threshold,
                                   int width, int height, const std::string& who);
  /// One value a row from one a proposal; zero for the rest.
  std::vector<float> of_rows(std::span<const double> d_logits) const;
  std::size_t count() const { return count_; }

 private:
  std::size_t count_ = 0;
  std::vector<std::size_t> places_;
};

}  // namespace mirage
