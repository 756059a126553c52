#include "attack/eot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/core.hpp>
#include <set>

#include "base/error.h"
#include "base/names.h"
#include "base/sizes.h"
#include "base/types.h"

namespace mirage {
namespace {

constexpr double kLowestSun = 3 * kDegree;
constexpr double kShape = 0.01, kMaxShape = 0.2;  // m

/// The number after the word's colon; nullopt if it is invalid.
template <class Number>
std::optional<Number> number_after_colon(const std::string& word) {
  return try_parse_number<Number>(std::string_view(word).substr(word.find(':') + 1));
}

/// The distance in "shape:0.02", in m.
double shape_of(const std::string& word) {
  const auto sigma = number_after_colon<double>(word);
  if (!sigma || !(*sigma > 0 && *sigma <= kMaxShape))
    throw FieldError("expectation", word, "is not a distance",
                     fmt::format("use metres over 0 and up to {}, as in shape:{}", kMaxShape, kShape));
  return *sigma;
}

/// The count in "worst:4" or "paints:24", a number of `what`.
double count_of(const std::string& word, const char* what, double most) {
  const auto count = number_after_colon<int>(word);
  if (!count || *count < 2 || *count > most)
    throw FieldError("expectation", word, fmt::format("is not a number of {}", what),
                     fmt::format("use 2 to {}, as in {}:4", most, word.substr(0, word.find(':'))));
  return *count;
}

/// The cluster of each texel, out of `count` (k-means, seeded by quantiles of luminance: deterministic).
std::vector<int> clusters_of(const std::vector<Vec3d>& texels, int count) {
  count = std::min(count, static_cast<int>(texels.size()));
  cv::Mat colours(static_cast<int>(texels.size()), 3, CV_32F), labels(colours.rows, 1, CV_32S);
  std::vector<int> by_luminance(texels.size());
  for (int i = 0; i < colours.rows; ++i) {
    by_luminance[as_size(i)] = i;
    for (int c = 0; c < 3; ++c) colours.at<float>(i, c) = static_cast<float>(texels[as_size(i)][c]);
  }
  std::ranges::stable_sort(by_luminance, {}, [&](int i) { return texels[as_size(i)].sum(); });
  for (int k = 0; k < colours.rows; ++k)
    labels.at<int>(by_luminance[as_size(k)]) =
        static_cast<int>(static_cast<std::int64_t>(k) * count / colours.rows);
  constexpr int kRounds = 20;
  if (count > 1)
    cv::kmeans(colours, count, labels, cv::TermCriteria(cv::TermCriteria::COUNT, kRounds, 0), 1,
               cv::KMEANS_USE_INITIAL_LABELS);
  return {labels.begin<int>(), labels.end<int>()};
}

/// Replaces each value by its cluster's mean; this linear map is its own VJP.
void average(const std::vector<int>& cluster, std::vector<Vec3d>& values) {
  std::vector<Vec3d> sum(cluster.size(), Vec3d::Zero());
  std::vector<double> count(cluster.size(), 0);
  for (std::size_t i = 0; i < values.size(); ++i) {
    sum[as_size(cluster[i])] += values[i];
    ++count[as_size(cluster[i])];
  }
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto k = as_size(cluster[i]);
    values[i] = sum[k] / count[k];
  }
}

/// `sun` turned by `angle` about a random perpendicular axis.
Vec3d turned_sun(const Vec3d& sun, double angle, double side) {
  const Vec3d across = sun.unitOrthogonal(), axis = Eigen::AngleAxisd(side, sun) * across;
  Vec3d turned = Eigen::AngleAxisd(angle, axis) * sun;
  const double lowest = std::sin(kLowestSun);
  if (turned.z() < lowest) {
    const double flat = std::hypot(turned.x(), turned.y()), horizontal = std::cos(kLowestSun);
    turned = flat > 0 ? Vec3d(turned.x() / flat * horizontal, turned.y() / flat * horizontal, lowest) : sun;
  }
  return turned.normalized();
}

}  // namespace

bool EotSettings::any() const {
  return any_in_frame() || any_in_object() || roof_shift > 0 || roof_yaw > 0 || tilt > 0 || image_noise > 0 ||
         range_noise > 0;
}

EotSettings parse_expectation(const std::string& words) {
  EotSettings e;
  const std::vector<std::string> listed = listed_words(words);
  std::set<std::string> names;
  for (const std::string& word : listed) {
    if (word == "none" && std::ranges::any_of(listed, [](const std::string& other) {
          return other != "none" && !other.starts_with("worst:");  // check_settings explains that error
        }))
      throw FieldError("expectation", words, "names none and something else",
                       "leave none out, or the others");
    if (!names.insert(word.substr(0, word.find(':'))).second)
      throw FieldError("expectation", words, "names " + word.substr(0, word.find(':')) + " twice",
                       "name each once");
  }
  for (const std::string& word : listed) {
    const bool all = word == "all";
    bool recognised = all || word == "none";
    if (word.starts_with("shape:")) {
      e.shape = shape_of(word);
      continue;
    }
    if (word.starts_with("worst:")) {
      e.worst = count_of(word, "draws", kMaxWorstDraws);
      continue;
    }
    if (word.starts_with("paints:")) {
      e.paints = count_of(word, "colours", kMaxPaints);
      continue;
    }
    const auto named = [&](const char* name) {
      recognised = recognised || word == name;
      return all || word == name;
    };
    if (named("roof")) {
      e.roof_shift = 0.05;
      e.roof_yaw = 2 * kDegree;
    }
    if (named("tilt")) e.tilt = 2 * kDegree;
    if (named("shape") && !(e.shape > 0)) e.shape = kShape;  // "all" beside a distance, whichever comes first
    if (named("colour")) e.colour = 0.15;
    if (named("sun")) e.sun = 20 * kDegree;
    if (named("light")) e.light = 0.3;
    if (named("exposure")) e.exposure = 0.2;
    if (named("noise")) {
      e.image_noise = 0.01;
      e.range_noise = 0.02;
    }
    if (!recognised)
      throw unknown_word("expectation", word,
                         {"roof", "tilt", "shape", "colour", "sun", "light", "exposure", "noise", "paints:24",
                          "worst:4", "all", "none"});
  }
  return e;
}

void require_judged(const EotSettings& expectation) {
  if (expectation.worst > 0)
    throw FieldError("expectation", fmt::format("worst:{}", expectation.worst), "is for mirage attack alone",
                     "leave it out: what is judged meets one draw for each vehicle");
}

void require_built(const EotSettings& expectation) {
  require_judged(expectation);
  const bool noise = expectation.image_noise > 0 || expectation.range_noise > 0;
  if (!expectation.any_in_frame() && !noise) return;
  const char* word = expectation.sun > 0        ? "sun"
                     : expectation.light > 0    ? "light"
                     : expectation.exposure > 0 ? "exposure"
                                                : "noise";
  throw FieldError("expectation", word,
                   "changes the world, and what is validated is the object in the recorded one",
                   "use some of shape, colour, paints, roof and tilt");
}

std::string text_of(const EotSettings& value) {
  return value.any() ? "some" : "none";
}

SampledEnvironment::SampledEnvironment(const EotSettings& expectation, std::uint64_t seed, std::uint64_t draw)
    : expectation_(expectation), seed_(seed), draw_(draw) {}

Placement SampledEnvironment::placement(const Placement& as_recorded) const {
  RandomStream random(seed_, "expected roof", draw_);
  const double s = expectation_.roof_shift;
  const double up = random.normal() * s / 5, across = random.normal() * s, along = random.normal() * s;
  const Vec3d shift(along, across, up);
  const double turn = random.normal() * expectation_.roof_yaw;
  const double roll = random.normal() * expectation_.tilt, pitch = random.normal() * expectation_.tilt;
  const auto move = [&](Transform& pose) {
    pose = pose * Eigen::Translation3d(shift) * Eigen::AngleAxisd(turn, Vec3d::UnitZ()) *
           Eigen::AngleAxisd(pitch, Vec3d::UnitY()) * Eigen::AngleAxisd(roll, Vec3d::UnitX());
  };
  Placement varied = as_recorded;
  move(varied.velo_from_adversary);
  if (varied.support == Support::roof && varied.carrier) move(varied.carrier->velo_from_roof);
  return varied;
}

PreparedFrame SampledEnvironment::frame(const PreparedFrame& as_recorded) const {
  RandomStream random(seed_, "expected light", draw_);
  PreparedFrame varied = as_recorded;
  Lighting& light = varied.frame.lighting;
  const double angle = random.normal() * expectation_.sun, side = random.uniform(0, 2 * std::numbers::pi),
               sun = std::exp(random.normal() * expectation_.light),
               sky = std::exp(random.normal() * expectation_.light),
               exposure = std::exp(random.normal() * expectation_.exposure);
  if (expectation_.sun > 0) light.to_sun_velo = turned_sun(light.to_sun_velo, angle, side);
  light.sun *= sun * exposure;
  light.ambient *= sky * exposure;
  light.hemisphere *= sky * exposure;
  if (expectation_.exposure > 0)
    for (float& value : varied.frame.image.data) value = std::min(1.0f, value * static_cast<float>(exposure));
  return varied;
}

SimulationSettings SampledEnvironment::simulation(const SimulationSettings& as_recorded) const {
  SimulationSettings varied = as_recorded;
  varied.lidar_effects.range_sigma =
      std::hypot(as_recorded.lidar_effects.range_sigma, expectation_.range_noise);
  varied.lidar_effects.seed = RandomStream(seed_, "expected returns", draw_).next_u32();
  varied.camera_effects.seed = RandomStream(seed_, "expected sensor noise", draw_).next_u32();
  return varied;
}

Vec3d SampledEnvironment::cast() const {
  RandomStream random(seed_, "expected cast", draw_);
  Vec3d cast;
  for (double& channel : cast) channel = std::exp(random.normal() * expectation_.colour);
  return cast;
}

TexturedMesh SampledEnvironment::built(const TexturedMesh& designed) const {
  TexturedMesh built = designed;
  RandomStream random(seed_, "expected shape", draw_);
  const double each = expectation_.shape / std::sqrt(3.0);
  for (Vec3d& v : built.mesh.vertices)
    for (double& coordinate : v) coordinate += random.normal() * each;
  std::vector<Vec3d>& texels = built.atlas.texels;
  if (expectation_.paints > 0) average(clusters_of(texels, static_cast<int>(expectation_.paints)), texels);
  if (!(expectation_.colour > 0)) return built;
  const Vec3d cast = this->cast();
  for (Vec3d& texel : texels) texel = texel.cwiseProduct(cast).cwiseMin(1.0);
  return built;
}

void SampledEnvironment::built_vjp(const TexturedMesh& designed, AdversaryGradient& gradient) const {
  if (!(expectation_.paints > 0) && !(expectation_.colour > 0)) return;
  std::vector<Vec3d> texels = designed.atlas.texels;
  std::vector<int> cluster;
  if (expectation_.paints > 0 && !gradient.texels.empty()) {
    cluster = clusters_of(texels, static_cast<int>(expectation_.paints));
    average(cluster, texels);
  }
  if (expectation_.colour > 0) {
    const Vec3d cast = this->cast();
    for (std::size_t i = 0; i < gradient.texels.size(); ++i)
      for (int c = 0; c < 3; ++c) gradient.texels[i][c] *= texels[i][c] * cast[c] < 1 ? cast[c] : 0;
  }
  if (!cluster.empty()) average(cluster, gradient.texels);
}

void SampledEnvironment::add_noise(ImageF& image) const {
  if (!(expectation_.image_noise > 0)) return;
  RandomStream random(seed_, "expected camera noise", draw_);
  for (float& value : image.data)
    value = std::clamp(value + static_cast<float>(random.normal() * expectation_.image_noise), 0.0f, 1.0f);
}

void SampledEnvironment::noise_vjp(const ImageF& noisy, ImageF& gradient) const {
  if (!(expectation_.image_noise > 0) || gradient.data.size() != noisy.data.size()) return;
  for (std::size_t i = 0; i < noisy.data.size(); ++i)
    if (noisy.data[i] <= 0 || noisy.data[i] >= 1) gradient.data[i] = 0;
}

SampledHost::SampledHost(const SampledEnvironment* draw, const PreparedFrame& recorded,
                         const Placement& placement, const TexturedMesh& designed,
                         const SimulationSettings& simulation)
    : draw_(draw),
      recorded_(recorded),
      designed_(designed),
      placement_(draw ? draw->placement(placement) : placement),
      simulation_(draw ? draw->simulation(simulation) : simulation) {
  if (draw && draw->expectation().any_in_frame()) frame_ = draw->frame(recorded);
  if (draw && draw->expectation().any_in_object()) built_ = draw->built(designed);
}

void SampledHost::vjp(AdversaryGradient& gradient) const {
  if (built_) draw_->built_vjp(designed_, gradient);
}

}  // namespace mirage
