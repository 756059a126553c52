// Detectors outside the program, in another one or in Python: what they say of themselves, and their answers,
// rows of boxes with their logits.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "detection/detector.h"

namespace mirage {

/// What one says of itself: the answer to hello (plugins/process/mirage_process.h).
struct OutsideWord {
  Capabilities can;
  std::array<double, 4> region = {0, 70, -40, 40};
  bool bytes = false;  ///< its pictures are 8-bit sRGB
};
/// What the object leaves out is as the protocol says. InputError naming `who` and the key that is wrong.
OutsideWord read_outside_word(const nlohmann::json& told, const std::string& who);
/// sensors() of the frame without the object, for one that saves work by it (Capabilities::why_whole); empty
/// where nothing is known of that.
std::vector<SensorData> clean_sensors_of(const SensorView& view, const Capabilities& can,
                                         const std::string& who);

/// Whether its numbers are: what it answers is looked at, gradients too.
bool all_finite(std::span<const float> values);

/// As arrays, row-major. Columns in the picture: left, top, right, bottom (pixels). Else in the ego frame, m
/// and rad: x, y, length, width, yaw; or x, y, z of the centre, length, width, height, yaw; or these and the
/// velocity's x and y (m/s).
struct RawBoxes {
  const float* boxes = nullptr;
  const float* logits = nullptr;
  std::size_t count = 0, columns = 0;
  std::span<const std::int32_t> classes = {};  ///< of each row, in Capabilities::types; empty: all the first
  std::span<const std::int32_t> identities = {};  ///< Detection::identity of each row; empty: none
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
