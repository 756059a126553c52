#include "scene/depth/depth_training.h"

#include <chrono>
#include <future>
#include <numeric>

#include "base/checkpoint_timer.h"
#include "base/error.h"
#include "base/files.h"
#include "base/interrupt.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/progress.h"
#include "base/random.h"
#include "base/schedule.h"
#include "base/training_state.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

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
nlohmann::json identity(const DepthTrainingOptions& options, std::size_t frames) {
  return {{"backend", options.backend},
          {"data", escape_name(fs::absolute(options.data).lexically_normal().string())},
          {"steps", options.steps},
          {"batch", options.batch},
          {"crop", options.crop},
          {"learning_rate", options.learning_rate},
          {"minutes", options.minutes},
          {"seed", options.seed},
          {"without_picture", options.augmentation.without_picture},
          {"shift", options.augmentation.shift},
          {"scatter", options.augmentation.scatter},
          {"start", options.start.empty() ? "" : content_hash(read_file(options.start))},
          {"frames", frames}};
}

}  // namespace

DepthTrainingResult train_depth(const DepthTrainingOptions& options) {
  if (options.steps < 1) throw InputError("--steps", "", "must be at least 1", "give a positive number");
  if (options.batch < 1) throw InputError("--batch", "", "must be at least 1", "give a positive number");
  if (options.crop < 64) throw InputError("--crop", "", "must be at least 64", "try 416");
  const DepthAugmentation& augmentation = options.augmentation;
  if (!(augmentation.without_picture >= 0 && augmentation.without_picture <= 1))
    throw InputError("--without-picture", "", "must be a share in [0, 1]", "try 0.3");
  if (!(augmentation.scatter >= 0 && augmentation.scatter <= 1))
    throw InputError("--scatter", "", "must be a share in [0, 1]", "try 0.3");
  if (augmentation.shift < 0 || augmentation.shift > 10)
    throw InputError("--shift", "", "must be 0 to 10 pixels", "try 1");
  if (!(options.learning_rate > 0)) throw InputError("--learning-rate", "", "must be positive", "try 0.002");
  make_output_folder(options.out);
  DepthOptions load{options.backend, {}, true, options.seed, options.threads};
  DepthData data(options);
  if (!options.start.empty()) {
    load.fresh = false;
    load.weights = options.start;
  }
  const nlohmann::json wanted = identity(options, data.size());
  TrainingState state = read_training_state(options.out, wanted);
  if (!state.weights.empty()) {
    load.fresh = false;
    load.weights = state.weights;
    spdlog::info("going on from step {} of {}", state.step, options.steps);
  }
  const auto model = load_learned_depth(load);

  const auto checkpoint = [&] {
    write_training_state(options.out, wanted, state, [&](const fs::path& file) { model->save(file, true); });
  };
  const double seconds_before = state.seconds;
  const std::int64_t first_step = state.step;
  const auto start = Clock::now();
  CheckpointTimer timer({options.checkpoint_every, options.checkpoint_seconds});
  const auto elapsed = [&] { return std::chrono::duration<double>(Clock::now() - start).count(); };
  const auto progress_now = [&] {
    const double by_steps = static_cast<double>(state.step) / static_cast<double>(options.steps);
    return options.minutes > 0 ? std::max(by_steps, state.seconds / (60 * options.minutes)) : by_steps;
  };
  {
    const auto prepare = [&](std::int64_t step) {
      return std::async(std::launch::async, [&data, step] { return data.prepare(step); });
    };
    auto next = prepare(state.step);
    Progress progress("train depth", static_cast<std::size_t>(options.steps), options.quiet);
    while (progress_now() < 1) {
      const std::vector<DepthSample> samples = next.get();
      next = prepare(state.step + 1);
      const double rate = one_cycle(options.learning_rate, progress_now());
      const auto loss = model->train_step(samples, rate);
      follow_losses(state, {loss[0], loss[1], loss[2]}, 0.01);
      ++state.step;
      state.seconds = seconds_before + elapsed();
      progress.update(static_cast<std::size_t>(state.step), fmt::format("loss {:.3f}", state.losses[0]));
      if (state.step % 100 == 0)
        spdlog::info("step {} rate {:.2e} loss {:.4f} depth {:.4f} presence {:.4f} {:.0f} s", state.step,
                     rate, state.losses[0], state.losses[1], state.losses[2], state.seconds);
      const bool stop = interrupted();
      if (const bool due = timer.due(state.step); stop || due) checkpoint();
      if (stop) throw Interrupted("interrupted; the checkpoint is kept, the same command goes on from it");
    }
  }

  DepthTrainingResult result;
  result.steps = state.step;
  result.seconds = state.seconds;
  result.seconds_per_step =
      state.step > first_step ? elapsed() / static_cast<double>(state.step - first_step) : 0;
  result.loss = state.losses;
  result.weights = options.out / (fs::path(options.backend).stem().string() + "-depth.weights");
  checkpoint();
  model->save(result.weights, false);
  return result;
}

}  // namespace mirage
