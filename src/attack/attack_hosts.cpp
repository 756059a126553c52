#include "attack/attack_hosts.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <functional>
#include <map>
#include <set>
#include <string>

#include "attack/evaluation.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/random.h"
#include "base/sizes.h"
#include "detection/car_in_picture.h"
#include "detection/detect.h"
#include "frames/frame_provenance.h"
#include "scene/data/kitti.h"
#include "scene/data/layouts.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

/// Labels for the cars that a detector finds in a frame.
std::vector<Label> found_cars(Detector& detector, const Frame& frame, double score) {
  std::vector<Label> labels;
  for (const Detection& found : detect_vehicles(detector, frame, score))
    if (auto label = projected_label("Car", upright(found, frame.sweep), frame.calibration))
      labels.push_back(std::move(*label));
  return labels;
}

constexpr double kMaxUnevenness = 1.25;

using FrameHosts = std::vector<std::size_t>;

std::size_t hosts_of(const std::vector<FrameHosts>& lane) {
  std::size_t sum = 0;
  for (const FrameHosts& frame : lane) sum += frame.size();
  return sum;
}

/// Gives each frame to the lane with the fewest hosts; `frames` come with most hosts first.
std::vector<std::vector<FrameHosts>> distribute_to_lanes(const std::vector<FrameHosts>& frames,
                                                         std::size_t lanes) {
  std::vector<std::vector<FrameHosts>> dealt(lanes);
  for (const FrameHosts& frame : frames) std::ranges::min_element(dealt, {}, hosts_of)->push_back(frame);
  return dealt;
}

bool even(const std::vector<std::vector<FrameHosts>>& lanes) {
  const auto [least, most] = std::ranges::minmax_element(lanes, {}, hosts_of);
  return static_cast<double>(hosts_of(*most)) <= kMaxUnevenness * static_cast<double>(hosts_of(*least));
}

}  // namespace

std::filesystem::path label_by_detections(const AttackSettings& settings, const DetectorPool& detectors) {
  const Detector& detector = *detectors.front();
  if (detector.capabilities().matching().in_picture())
    throw FieldError("hosts_from", "detections",
                     detector.name() + " finds boxes in the picture, which stand nowhere in space",
                     "use a detector that reads the LiDAR's returns");
  std::vector<std::string> unlabelled;
  for (const std::string& id : list_frames(settings.data))
    if (!read_annotations(settings.data, id).labelled) unlabelled.push_back(id);
  if (unlabelled.empty())
    throw FieldError("hosts_from", "detections", "every frame has labels", "leave it out");
  std::filesystem::path folder = settings.out / "labelled";
  const double score = EvaluationSettings{}.score_threshold;
  // Everything that determines the detections, except hashes of programs and plugins: a finished run
  // continues with newer ones.
  const nlohmann::json about = {{"detector", settings.detector.detector},
                                {"weights_hash", settings.weights_hash},
                                {"defense", settings.detector.defense},
                                {"precision", settings.detector.precision},
                                {"matching", to_word(settings.detector.matching)},
                                {"classes", settings.classes},
                                {"frames_hash", frames_hash(settings.data, unlabelled, settings.cameras)},
                                {"score", score}};
  // Existing labels stay: a finished run's hosts are among them.
  if (are_labels_of(folder, settings.data, about))
    std::erase_if(unlabelled, [&](const std::string& id) {
      return std::filesystem::exists(folder / "label_2" / (id + ".txt"));
    });
  if (unlabelled.empty()) return folder;
  std::atomic<std::size_t> cars = 0;
  for_each_with_detector(detectors, unlabelled.size(), [&](Detector& own, std::size_t i) {
    throw_if_interrupted("frames are looked at anew");
    const Frame frame = read_frame(settings.data, unlabelled[i]);
    const std::vector<Label> found = found_cars(own, frame, score);
    cars += found.size();
    write_labels(folder / "label_2" / (frame.id + ".txt"), found, frame.calibration);
  });
  write_separate_labels(folder, settings.data, about);
  spdlog::warn("{} cars in {} unlabelled frames are {}'s own detections, so its AP on them means nothing",
               cars.load(), unlabelled.size(), detector.name());
  return folder;
}

ValidationPart split_validation(const std::vector<Host>& train, std::uint64_t seed, std::size_t at_most,
                                const char* field) {
  std::map<std::string, std::size_t> hosts;  // by frame
  for (const Host& host : train) ++hosts[host.id.frame];
  std::vector<std::string> frames;
  for (const auto& [frame, count] : hosts) frames.push_back(frame);
  if (frames.size() < 2)
    throw FieldError(field, std::to_string(frames.size()) + " training frame",
                     "has no second one to hold out", "give more frames, or leave the option out");
  RandomStream random(seed, "validation part");
  shuffle(frames, random);
  const auto most = std::clamp<std::size_t>(
      as_size(std::lround(kHeldOutShare * static_cast<double>(frames.size()))), 1, frames.size() - 1);
  std::set<std::string> held_out_frames;
  std::size_t vehicles = 0;
  for (std::size_t i = 0; i < most && vehicles < at_most; ++i) {
    held_out_frames.insert(frames[i]);
    vehicles += hosts[frames[i]];
  }
  ValidationPart part;
  for (const Host& host : train)
    (held_out_frames.contains(host.id.frame) ? part.held_out : part.learn).push_back(host);
  return part;
}

HostOrder::HostOrder(std::span<const Host> hosts, int batch, std::uint64_t seed)
    : batch_(batch), seed_(seed) {
  std::map<std::string, FrameHosts> by_frame;
  for (std::size_t i = 0; i < hosts.size(); ++i) by_frame[hosts[i].id.frame].push_back(i);
  std::vector<FrameHosts> frames;
  for (const auto& [name, list] : by_frame) frames.push_back(list);
  RandomStream random(seed, "lanes of frames");
  shuffle(frames, random);
  std::ranges::stable_sort(frames, std::greater(), std::ranges::size);
  std::size_t lanes = std::min(as_size(batch), frames.size());
  while (!even(lanes_ = distribute_to_lanes(frames, lanes))) --lanes;  // a single lane is always even
}

std::vector<std::size_t> HostOrder::drawn_order(std::size_t lane, long pass) const {
  RandomStream random(seed_, "host order", static_cast<std::uint64_t>(pass) * lanes_.size() + lane);
  Lane waiting = lanes_[lane];
  shuffle(waiting, random);
  const std::size_t most = std::max<std::size_t>(1, kOpenFrames / lanes_.size());
  std::vector<std::size_t> order;
  Lane open;
  const std::size_t all = hosts_of(waiting);
  while (order.size() < all) {
    while (open.size() < most && !waiting.empty()) {
      open.push_back(std::move(waiting.back()));
      waiting.pop_back();
    }
    auto drawn = as_size(random.below(static_cast<int>(hosts_of(open))));
    auto frame = open.begin();
    for (; drawn >= frame->size(); ++frame) drawn -= frame->size();
    order.push_back((*frame)[drawn]);
    frame->erase(frame->begin() + static_cast<std::ptrdiff_t>(drawn));
    if (frame->empty()) open.erase(frame);
  }
  return order;
}

std::size_t HostOrder::places(std::size_t lane) const {
  return (as_size(batch_) - lane + lanes_.size() - 1) / lanes_.size();
}

std::vector<std::size_t> HostOrder::order(std::size_t lane, long pass) const {
  std::vector<std::size_t> order = drawn_order(lane, pass);
  const std::size_t head = places(lane) - 1;  // places that may share a batch with the previous pass
  if (head == 0 || pass == 0 || order.size() < 3 * head) return order;
  const std::vector<std::size_t> before = drawn_order(lane, pass - 1);
  const auto just_met = [&](std::size_t host) {
    return std::find(before.end() - static_cast<std::ptrdiff_t>(head), before.end(), host) != before.end();
  };
  // Swaps only with the middle: the next pass relies on the end as drawn.
  std::size_t other = head;
  for (std::size_t i = 0; i < head; ++i) {
    if (!just_met(order[i])) continue;
    while (other < order.size() - head && just_met(order[other])) ++other;
    if (other == order.size() - head) break;
    std::swap(order[i], order[other++]);
  }
  return order;
}

std::vector<std::size_t> HostOrder::batch(long iteration) const {
  std::vector<std::size_t> indices;
  const auto batch = as_size(batch_);
  struct Pass {
    long number = -1;
    std::vector<std::size_t> hosts;
  };
  std::vector<Pass> passes(lanes_.size());
  for (std::size_t k = 0; k < batch; ++k) {
    const std::size_t lane = k % lanes_.size();
    const long position = iteration * static_cast<long>(places(lane)) + static_cast<long>(k / lanes_.size());
    const auto hosts = static_cast<long>(hosts_of(lanes_[lane]));
    Pass& pass = passes[lane];
    if (pass.number != position / hosts) pass = {position / hosts, order(lane, position / hosts)};
    indices.push_back(pass.hosts[as_size(position % hosts)]);
  }
  return indices;
}

}  // namespace mirage
