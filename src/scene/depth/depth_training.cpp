#include "scene/depth/depth_training.h"

#include <numeric>

#include "base/field_json.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/random.h"
#include "base/training_loop.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

constexpr std::size_t kMemory = std::size_t{4} << 30;  // bytes for frames kept between epochs

class DepthData {
 public:
  explicit DepthData(const DepthTrainingOptions& options)
      : options_(options), ids_(list_frames(options.data)) {
    if (options.frames > 0 && ids_.size() > options.frames) ids_.resize(options.frames);
    frames_.resize(ids_.size());
  }
  std::size_t size() const { return ids_.size(); }

  std::vector<DepthSample> prepare(std::int64_t step) {
    std::vector<DepthSample> samples;
    for (int i = 0; i < options_.batch; ++i) {
      const auto index = static_cast<std::uint64_t>(step) * options_.batch + i;
      samples.push_back(
          augmented_crop(frame(frame_of(index)), options_.crop, options_.seed, index, options_.augmentation));
    }
    return samples;
  }

 private:
  /// Every frame once an epoch, in an order of the epoch's own.
  std::size_t frame_of(std::uint64_t index) const {
    const std::uint64_t count = ids_.size();
    std::vector<std::size_t> order(count);
    std::iota(order.begin(), order.end(), std::size_t{0});
    RandomStream random(options_.seed, "depth training order", index / count);
    for (std::size_t i = count; i-- > 1;) std::swap(order[i], order[random.below(static_cast<int>(i) + 1)]);
    return order[index % count];
  }

  const DepthFrame& frame(std::size_t number) {
    if (!frames_[number].image.empty()) return frames_[number];
    DepthFrame read = read_depth_frame(options_.data, ids_[number]);
    const std::size_t bytes = 5 * sizeof(float) * read.sparse.data.size();
    if (bytes_ + bytes > kMemory) return passing_ = std::move(read);
    bytes_ += bytes;
    return frames_[number] = std::move(read);
  }

  DepthTrainingOptions options_;
  std::vector<std::string> ids_;
  std::vector<DepthFrame> frames_;
  DepthFrame passing_;  // where memory is full
  std::size_t bytes_ = 0;
};

/// What must agree for a run to go on.
RunIdentity identity(const DepthTrainingOptions& options, std::size_t frames) {
  nlohmann::json json = fields_json(options);
  json["start"] = options.start.empty() ? "" : file_hash(options.start);
  json["frames"] = frames;
  return {json, lacking_json<DepthTrainingOptions>()};
}

}  // namespace

DepthTrainingResult train_depth(const DepthTrainingOptions& options) {
  check_fields(options);
  make_output_folder(options.out);
  DepthData data(options);
  TrainingLoop loop(options, identity(options, data.size()));
  const std::filesystem::path weights = loop.goes_on() ? loop.state().weights : options.start;
  const auto model =
      load_learned_depth({options.backend, weights, weights.empty(), options.seed, options.threads});
  const auto& losses = loop.state().losses;  // total, depth, presence

  SamplesAhead<std::vector<DepthSample>> ahead([&](std::int64_t step) { return data.prepare(step); });
  TrainingWork work;
  work.name = "train depth";
  work.follow = 0.01;
  work.tell_every = 100;
  work.learn = [&](std::int64_t step, double rate) {
    const auto loss = model->train_step(ahead.take(step), rate);
    return std::array<double, 3>{loss[0], loss[1], loss[2]};
  };
  work.save = [&](const std::filesystem::path& file) { model->save(file, true); };
  work.note = [&] { return fmt::format("loss {:.3f}", losses[0]); };
  work.tell = [&](double rate) {
    spdlog::info("step {} rate {:.2e} loss {:.4f} depth {:.4f} presence {:.4f} {:.0f} s", loop.state().step,
                 rate, losses[0], losses[1], losses[2], loop.state().seconds);
  };

  DepthTrainingResult result;
  result.seconds_per_step = loop.run(work);
  result.steps = loop.state().step;
  result.seconds = loop.state().seconds;
  result.loss = losses;
  result.weights = options.out / (std::filesystem::path(options.backend).stem().string() + "-depth.weights");
  model->save(result.weights, false);
  return result;
}

}  // namespace mirage
