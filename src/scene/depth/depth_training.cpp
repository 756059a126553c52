#include "scene/depth/depth_training.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "base/error.h"
#include "base/field_json.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/logging.h"
#include "base/random.h"
#include "base/training_loop.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"

namespace mirage {
namespace {

ImageF crop(const ImageF& image, int u0, int width, bool mirrored) {
  ImageF out(width, image.height, image.channels);
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < width; ++u)
      std::copy_n(image.pixel(u0 + (mirrored ? width - 1 - u : u), v), image.channels, out.pixel(u, v));
  return out;
}

void hide_rectangles(ImageF& sparse, RandomStream& random) {
  const int count = 1 + random.below(5);
  for (int i = 0; i < count; ++i) {
    const int width = 8 + random.below(90), height = 8 + random.below(50);
    const int u0 = random.below(sparse.width) - width / 2, v0 = random.below(sparse.height) - height / 2;
    for (int v = std::max(0, v0); v < std::min(sparse.height, v0 + height); ++v)
      for (int u = std::max(0, u0); u < std::min(sparse.width, u0 + width); ++u) sparse.at(u, v) = 0;
  }
}

/// Hides, shifts and shakes the returns.
ImageF changed_returns(const ImageF& sparse, int shift, RandomStream& random) {
  const double hidden = random.uniform() < 0.3 ? 0 : random.uniform(0, 0.5);
  const double shaking = random.uniform(0, 0.03);
  const bool shifted = random.uniform() < 0.3, holes = random.uniform() < 0.3;
  const auto move = [&] { return shifted ? random.below(2 * shift + 1) - shift : 0; };
  const int du = move(), dv = move();
  ImageF changed(sparse.width, sparse.height, 1);
  for (int v = 0; v < sparse.height; ++v)
    for (int u = 0; u < sparse.width; ++u) {
      const float depth = sparse.at(u, v);
      if (!(depth > 0) || random.uniform() < hidden) continue;
      const int to_u = u + du, to_v = v + dv;
      if (to_u < 0 || to_v < 0 || to_u >= sparse.width || to_v >= sparse.height) continue;
      changed.at(to_u, to_v) = std::max(0.1f, depth + static_cast<float>(shaking * random.normal()));
    }
  if (holes) hide_rectangles(changed, random);
  return changed;
}

ImageF scattered(const ImageF& sparse, double largest_share, RandomStream random) {
  const double share = random.uniform(0, largest_share), range_noise = random.uniform(0, 0.05);
  ImageF out(sparse.width, sparse.height, 1);
  for (int v = 0; v < sparse.height; ++v)
    for (int u = 0; u < sparse.width; ++u) {
      float depth = sparse.at(u, v);
      if (!(depth > 0)) continue;
      int to_u = u, to_v = v;
      if (random.uniform() < share) {
        to_u = std::clamp(u + random.below(7) - 3, 0, sparse.width - 1);
        to_v = std::clamp(v + random.below(5) - 2, 0, sparse.height - 1);
        depth *= static_cast<float>(std::exp(range_noise * random.normal()));
      }
      float& there = out.at(to_u, to_v);
      if (there == 0 || depth < there) there = depth;
    }
  return out;
}

void change_picture(ImageF& image, RandomStream& random) {
  const double exposure = std::exp(random.uniform(-0.6, 0.6)), gamma = std::exp(random.uniform(-0.25, 0.25));
  const double grey = random.uniform(0, 0.8), noise = random.uniform(0, 0.03);
  double gain[3];
  for (double& g : gain) g = exposure * std::exp(random.uniform(-0.15, 0.15));
  for (std::size_t i = 0; i < image.data.size(); i += 3) {
    double rgb[3], mean = 0;
    for (int c = 0; c < 3; ++c) mean += (rgb[c] = gain[c] * image.data[i + c]) / 3;
    for (int c = 0; c < 3; ++c) {
      const double x = std::pow(std::clamp(rgb[c] + grey * (mean - rgb[c]), 0.0, 1.0), gamma);
      // Uniform noise of that deviation: a normal deviate a channel would cost more than the network.
      image.data[i + c] = static_cast<float>(
          std::clamp(x + noise * std::sqrt(x + 1e-3) * random.uniform(-1.73, 1.73), 0.0, 1.0));
    }
  }
}

}  // namespace

DepthFrame read_depth_frame(const std::filesystem::path& data, const std::string& id) {
  const auto file = true_depth_file(data, id);
  if (!std::filesystem::exists(file))
    throw InputError(file.string(), "", "missing (the frame's true depth)",
                     "make the data set with mirage generate --depth");
  const Frame frame = read_frame(data, id);
  DepthFrame out{frame.image, sparse_depth(frame.sweep, frame.calibration), read_depth_png(file)};
  if (out.truth.width != out.image.width || out.truth.height != out.image.height)
    throw InputError(file.string(), "size", "differs from the picture's", "make the data set anew");
  return out;
}

DepthSample augmented_crop(const DepthFrame& frame, int width, std::uint64_t seed, std::uint64_t index,
                           const DepthAugmentation& augmentation) {
  RandomStream random(seed, "depth augmentation", index);
  width = std::min(width, frame.image.width);
  const int u0 = random.below(frame.image.width - width + 1);
  const bool mirrored = random.uniform() < 0.5;
  const float scale = static_cast<float>(random.uniform(0.85, 1.15));
  DepthSample sample{crop(frame.image, u0, width, mirrored), crop(frame.sparse, u0, width, mirrored),
                     crop(frame.truth, u0, width, mirrored)};
  for (float& depth : sample.sparse.data) depth *= scale;
  for (float& depth : sample.truth.data) depth *= scale;
  sample.sparse = changed_returns(sample.sparse, augmentation.shift, random);
  if (augmentation.scatter > 0)
    sample.sparse = scattered(sample.sparse, augmentation.scatter, {seed, "depth scatter", index});
  change_picture(sample.image, random);
  if (random.uniform() < augmentation.without_picture)
    std::fill(sample.image.data.begin(), sample.image.data.end(), 0.2f);
  return sample;
}

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
