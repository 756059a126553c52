#include "scene/depth/learned_depth.h"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <nlohmann/json.hpp>
#include <numeric>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/image.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/parallel.h"
#include "base/plugins.h"
#include "base/random.h"
#include "base/training_loop.h"
#include "scene/data/kitti.h"
#include "scene/data/read_frames.h"
#include "scene/depth/depth_abi.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

constexpr const char* kDepthPlugins = "depth";

fs::path find_plugin(const std::string& backend) {
  if (is_plugin_path(backend)) {
    if (!fs::exists(backend))
      throw InputError(backend, "", "no such depth completion plugin", "check --depth");
    return fs::absolute(backend);
  }
  const ShippedPlugin* plugin = shipped_plugin(kDepthPlugins, backend);
  if (plugin && fs::exists(plugin->file)) return plugin->file;
  std::vector<std::string> networks{kDefaultDepth};
  for (const ShippedPlugin& shipped : shipped_plugins(kDepthPlugins))
    networks.insert(networks.end(), shipped.words.begin(), shipped.words.end());
  if (plugin || networks.size() == 1)
    throw InputError(plugin ? plugin->file.string() : built_file("plugins").string(), "",
                     "the depth completion plugin is missing",
                     "build it with MIRAGE_DETECTORS=ON (make build), or use --depth ip-basic");
  throw unknown_word("depth", backend, networks, "a plugin (*.so)");
}

fs::path find_weights(const DepthOptions& options, const fs::path& plugin) {
  const fs::path file = options.weights.empty()
                            ? plugin.parent_path() / "weights" / (plugin.stem().string() + "-depth.weights")
                            : options.weights;
  if (fs::is_regular_file(file)) return file;
  throw InputError(file.string(), "",
                   options.weights.empty() ? "the shipped weights are missing" : "no such weights file",
                   "name others, or train some with mirage train depth");
}

/// Sets returns that are not positive and finite to 0 (no return).
ImageF cleaned(const ImageF& sparse) {
  ImageF clean = sparse;
  for (float& value : clean.data)
    if (!(value > 0) || !std::isfinite(value)) value = 0;
  return clean;
}

void check_pixels(const ImageF& image, const ImageF& sparse) {
  if (image.width != sparse.width || image.height != sparse.height || image.channels != 3 ||
      sparse.channels != 1)
    throw InputError("depth completion", "image", "is not an RGB picture of the sparse depth's size",
                     "give both of one frame");
  for (std::size_t i = 0; i < image.data.size(); ++i)
    if (!std::isfinite(image.data[i])) {
      const auto pixel = static_cast<long>(i / 3);
      throw InputError("depth completion",
                       "image, pixel (" + std::to_string(pixel % image.width) + ", " +
                           std::to_string(pixel / image.width) + ")",
                       "not a finite number", "check the picture's source");
    }
}

MirageDepthInput raw_input(const ImageF& image, const ImageF& sparse) {
  return {image.data.data(), sparse.data.data(), sparse.width, sparse.height};
}

class PluginDepth : public LearnedDepth {
 public:
  PluginDepth(fs::path file, const MirageDepthApi* api, void* instance)
      : file_(std::move(file)), api_(api), instance_(instance) {}
  PluginDepth(const PluginDepth&) = delete;
  PluginDepth& operator=(const PluginDepth&) = delete;
  ~PluginDepth() override { api_->destroy(instance_); }

  std::string name() const override { return api_->name; }

  ImageF complete(const ImageF& image, const ImageF& sparse) const override {
    if (sparse.empty()) return {};
    check_pixels(image, sparse);
    const ImageF clean = cleaned(sparse);
    const MirageDepthInput input = raw_input(image, clean);
    ImageF dense(sparse.width, sparse.height, 1);
    {
      const std::scoped_lock lock(mutex_);
      run_plugin(file_, "complete", [&](char* error) {
        return api_->complete(instance_, &input, dense.data.data(), error, kPluginErrorSize);
      });
    }
    for (float& value : dense.data) {
      if (!std::isfinite(value))
        throw Failure(file_.string(), "complete gave a depth that is not finite",
                      "check the weights and the input");
      if (!(value > 0)) value = kFarDepth;
    }
    return dense;
  }

  std::array<float, 3> train_step(std::span<const DepthSample> samples, double learning_rate) override {
    std::vector<MirageDepthSample> raw;
    for (const DepthSample& sample : samples) {
      check_pixels(sample.image, sample.sparse);
      if (sample.truth.data.size() != sample.sparse.data.size())
        throw InputError("depth completion", "truth", "is not of the sparse depth's size",
                         "give both of one frame");
      raw.push_back({raw_input(sample.image, sample.sparse), sample.truth.data.data()});
    }
    std::array<float, 3> loss{};
    const std::scoped_lock lock(mutex_);
    run_plugin(file_, "train_step", [&](char* error) {
      return api_->train_step(instance_, raw.data(), static_cast<std::int64_t>(raw.size()),
                              static_cast<float>(learning_rate), loss.data(), error, kPluginErrorSize);
    });
    return loss;
  }

  void save(const fs::path& file, bool with_optimiser) override {
    const fs::path temporary = file.string() + ".part";
    if (file.has_parent_path()) make_output_folder(file.parent_path());
    run_plugin(file_, "save", [&](char* error) {
      return api_->save(instance_, temporary.c_str(), with_optimiser, error, kPluginErrorSize);
    });
    replace_file(temporary, file);
  }

 private:
  fs::path file_;
  const MirageDepthApi* api_;
  void* instance_;
  mutable std::mutex mutex_;  // an instance is used by one thread at a time
};

std::unique_ptr<DepthCompletion> classical(const std::string& backend) {
  for (const bool multi_scale : {false, true})
    for (const auto blur : {IpBasicOptions::Blur::gaussian, IpBasicOptions::Blur::bilateral})
      for (const bool extrapolate : {false, true}) {
        auto completion = std::make_unique<IpBasic>(IpBasicOptions{multi_scale, blur, extrapolate});
        if (completion->name() == backend) return completion;
      }
  return nullptr;
}

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

/// Hides, shifts and perturbs the returns.
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
    for (std::size_t c = 0; c < 3; ++c) mean += (rgb[c] = gain[c] * image.data[i + c]) / 3;
    for (std::size_t c = 0; c < 3; ++c) {
      const double x = std::pow(std::clamp(rgb[c] + grey * (mean - rgb[c]), 0.0, 1.0), gamma);
      // Uniform noise of the same deviation: normal deviates would cost more than the network.
      image.data[i + c] = static_cast<float>(
          std::clamp(x + noise * std::sqrt(x + 1e-3) * random.uniform(-1.73, 1.73), 0.0, 1.0));
    }
  }
}

constexpr std::size_t kMemory = std::size_t{4} << 30;  // bytes for frames kept between epochs

class DepthData {
 public:
  explicit DepthData(const DepthTrainingOptions& options)
      : options_(options), ids_(list_frames(options.data, options.frames)) {
    frames_.resize(ids_.size());
  }
  const std::vector<std::string>& ids() const { return ids_; }

  std::vector<DepthSample> prepare(std::int64_t step) {
    std::vector<DepthSample> samples;
    for (int i = 0; i < options_.batch; ++i) {
      const auto index = static_cast<std::uint64_t>(step) * as_size(options_.batch) + as_size(i);
      samples.push_back(
          augmented_crop(frame(frame_of(index)), options_.crop, options_.seed, index, options_.augmentation));
    }
    return samples;
  }

 private:
  /// Every frame once an epoch, in an order drawn anew for each epoch.
  std::size_t frame_of(std::uint64_t index) const {
    const std::uint64_t count = ids_.size();
    std::vector<std::size_t> order(count);
    std::iota(order.begin(), order.end(), std::size_t{0});
    RandomStream random(options_.seed, "depth training order", index / count);
    shuffle(order, random);
    return order[index % count];
  }

  const DepthSample& frame(std::size_t number) {
    if (!frames_[number].image.empty()) return frames_[number];
    DepthSample read = read_depth_frame(options_.data, ids_[number]);
    const std::size_t bytes = 5 * sizeof(float) * read.sparse.data.size();
    if (bytes_ + bytes > kMemory) return passing_ = std::move(read);
    bytes_ += bytes;
    return frames_[number] = std::move(read);
  }

  DepthTrainingOptions options_;
  std::vector<std::string> ids_;
  std::vector<DepthSample> frames_;
  DepthSample passing_;  // used when memory is full
  std::size_t bytes_ = 0;
};

/// The identity that must agree for a run to resume.
RunIdentity identity(const DepthTrainingOptions& options, std::span<const std::string> frames) {
  nlohmann::json json = fields_json(options), lacking = lacking_json<DepthTrainingOptions>();
  json["start"] = options.start.empty() ? "" : file_hash(options.start);
  json["frames"] = frames.size();
  json["frames_hash"] = training_frames_hash(options.data, frames);
  lacking["frames_hash"] = json["frames_hash"];  // runs of earlier versions lack it
  return {json, lacking};
}

}  // namespace

std::string training_frames_hash(const fs::path& data, std::span<const std::string> ids) {
  const auto set = open_data_set(data);
  std::vector<std::string> hashes(ids.size());
  parallel_for(ids.size(), [&](std::size_t i) {
    hashes[i] = escape_name(ids[i]) + "\n" + set->hash(ids[i]);
    for (const fs::path& truth :
         {true_depth_file(data, ids[i]), instance_file(data, ids[i]), point_label_file(data, ids[i])})
      hashes[i].append("\n").append(fs::exists(truth) ? file_hash(truth) : "");
  });
  return content_hash(nlohmann::json(hashes).dump());
}

bool is_shipped_depth(const std::string& backend) {
  return shipped_plugin(kDepthPlugins, backend) != nullptr || classical(backend) != nullptr;
}

std::unique_ptr<LearnedDepth> load_learned_depth(const DepthOptions& options) {
  const fs::path file = find_plugin(options.backend);
  const auto* api =
      open_plugin<MirageDepthApi>(file, "mirage_depth_api", "scene/depth/depth_abi.h", {MIRAGE_DEPTH_ABI});
  if (!api->create || !api->destroy || !api->complete || !api->train_step || !api->save)
    throw InputError(file.string(), "mirage_depth_api", "a function is missing", "rebuild the plugin");
  const fs::path weights = options.fresh ? fs::path() : find_weights(options, file);
  const nlohmann::json settings = {{"seed", options.seed},
                                   {"threads", options.threads > 0 ? options.threads : thread_count()}};
  const std::string text = settings.dump();
  char error[kPluginErrorSize] = "";
  void* instance = call_plugin(file, "create", [&] {
    return api->create(text.c_str(), options.fresh ? nullptr : weights.c_str(), error, kPluginErrorSize);
  });
  if (!instance)
    throw InputError(options.fresh ? file.string() : weights.string(), "",
                     error[0] ? error : "the plugin gave no reason",
                     options.fresh ? "check the plugin's options" : "check the weights");
  return std::make_unique<PluginDepth>(file, api, instance);
}

std::string depth_identity(const DepthOptions& options) {
  if (classical(options.backend)) return options.backend;
  const fs::path plugin = find_plugin(options.backend);
  const std::string weights =
      options.fresh ? "fresh " + std::to_string(options.seed) : file_hash(find_weights(options, plugin));
  return file_hash(plugin) + " " + weights + " " +
         std::to_string(options.threads > 0 ? options.threads : thread_count());
}

std::unique_ptr<DepthCompletion> load_depth_completion(const DepthOptions& options) {
  if (auto completion = classical(options.backend)) return completion;
  return load_learned_depth(options);
}

DepthSample read_depth_frame(const std::filesystem::path& data, const std::string& id) {
  const auto file = true_depth_file(data, id);
  if (!std::filesystem::exists(file))
    throw InputError(file.string(), "", "missing (the frame's true depth)",
                     "make the data set with mirage generate --depth");
  const Frame frame = read_frame(data, id);
  DepthSample out{frame.image, sparse_depth(frame.sweep, frame.calibration), read_depth_png(file)};
  if (out.truth.width != out.image.width || out.truth.height != out.image.height)
    throw InputError(file.string(), "size", "differs from the picture's", "make the data set anew");
  return out;
}

DepthSample augmented_crop(const DepthSample& frame, int width, std::uint64_t seed, std::uint64_t index,
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

DepthTrainingResult train_depth(const DepthTrainingOptions& options) {
  check_fields(options);
  make_output_folder(options.out);
  DepthData data(options);
  TrainingLoop loop(options, identity(options, data.ids()));
  const std::filesystem::path weights = loop.goes_on() ? loop.state().weights : options.start;
  const auto model =
      load_learned_depth({options.backend, weights, weights.empty(), options.seed, options.threads});
  const auto& losses = loop.state().losses;  // total, depth, presence

  SamplePrefetcher<std::vector<DepthSample>> ahead([&](std::int64_t step) { return data.prepare(step); });
  TrainingWork work;
  work.name = "train depth";
  work.follow = 0.01;
  work.report_every = 100;
  work.learn = [&](std::int64_t step, double rate) {
    const auto loss = model->train_step(ahead.take(step), rate);
    return std::array<double, 3>{loss[0], loss[1], loss[2]};
  };
  work.save = [&](const std::filesystem::path& file) { model->save(file, true); };
  work.note = [&] { return fmt::format("loss {:.3f}", losses[0]); };
  work.report = [&](double rate) {
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
