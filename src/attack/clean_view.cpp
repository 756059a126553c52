#include "attack/clean_view.h"

#include <array>
#include <bit>
#include <cstring>

#include "base/error.h"
#include "detection/points_in_view.h"

namespace mirage {
namespace {

/// Eight independent sums of products of 8 bytes each: as fast as memory is read. Tells contents apart; no
/// protection against malice.
class Hash {
 public:
  void add(const void* bytes, std::size_t size) {
    const auto* from = static_cast<const std::byte*>(bytes);
    for (; size >= kBlock; size -= kBlock, from += kBlock) {
      std::array<std::uint64_t, kLanes> words;
      std::memcpy(words.data(), from, kBlock);
      for (std::size_t k = 0; k < kLanes; ++k)
        lanes_[k] = std::rotl(lanes_[k] ^ words[k], 29) * 0x9e3779b97f4a7c15ull;
    }
    std::array<std::uint64_t, kLanes> rest{};
    std::memcpy(rest.data(), from, size);
    for (std::size_t k = 0; k < kLanes; ++k)
      lanes_[k] = std::rotl(lanes_[k] ^ rest[k] ^ size, 31) * 0xbf58476d1ce4e5b9ull;
  }
  std::uint64_t value() const {
    std::uint64_t all = 0;
    for (const std::uint64_t lane : lanes_) all = (all ^ lane ^ (all >> 31)) * 0x94d049bb133111ebull;
    return all ^ (all >> 29);
  }

 private:
  static constexpr std::size_t kLanes = 8, kBlock = kLanes * sizeof(std::uint64_t);
  std::array<std::uint64_t, kLanes> lanes_ = {1, 2, 3, 4, 5, 6, 7, 8};
};

}  // namespace

SensorView view_of(const PreparedFrame& prepared, const Simulated& simulated, const Capabilities& can) {
  const Frame& frame = prepared.frame;
  SensorView view = view_of(frame, simulated.image, simulated.sweep);
  for (std::size_t k = 0; k < frame.others.size(); ++k)
    if (const ImageF& image = simulated.others[k].image; !image.empty() && can.names(frame.others[k].name))
      view.others.push_back(sensor_beside(frame, k, &image));
  for (std::size_t k = 0; k < simulated.measurements.size(); ++k)
    if (const Measurement& measured = simulated.measurements[k]; can.names(measured.name)) {
      view.others.push_back(sensor_beside(frame, frame.others.size() + k));
      view.others.back().values = measured.data;
    }
  return view;
}

void require_no_others(const SensorView& view) {
  if (view.others.empty()) return;
  throw InputError("expect, renderer", view.others[0].name,
                   "is not drawn by them: they know of a frame's first camera and LiDAR alone",
                   "leave them off with a detector that reads further sensors");
}

std::vector<const float*> others_of(const SensorGradient& gradient, const Frame& frame,
                                    const Simulated& simulated) {
  std::vector<const float*> others;
  const auto add = [&](const std::string& name, std::size_t values) {
    const auto given = gradient.others.find(name);
    const bool there = given != gradient.others.end() && values > 0 && given->second.size() == values;
    others.push_back(there ? given->second.data() : nullptr);
  };
  for (std::size_t k = 0; k < simulated.others.size(); ++k)
    add(frame.others[k].name, simulated.others[k].rect.empty() ? 0 : simulated.others[k].image.data.size());
  for (const Measurement& measured : simulated.measurements) add(measured.name, measured.data.size());
  return others;
}

CleanView clean_view(const PreparedFrame& prepared, const PixelRect& changed) {
  const Frame& frame = prepared.frame;
  Hash hash;
  hash.add(frame.image.data.data(), frame.image.data.size() * sizeof(float));
  hash.add(frame.sweep.data(), frame.sweep.size() * sizeof(LidarPoint));
  const std::array<double, 12> projection = pixel_from_velo(frame.calibration);
  hash.add(projection.data(), sizeof(projection));
  return {&frame.image, frame.sweep, hash.value(), changed};
}

}  // namespace mirage
