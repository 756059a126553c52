// How well --sun photo finds the sun on generated frames, whose sun is known:
//
//     mirage_sun_study DATA
//
// One line a frame: the azimuth's and the elevation's error, what the estimate says of itself and how strong
// the true sun is beside the sky. Then the median error and the share within 20°, of the frames that the
// photograph decides and of all with a guess.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <vector>

#include "base/angles.h"
#include "base/error.h"
#include "scene/data/read_frames.h"
#include "scene/recorded_light.h"

namespace mirage {
namespace {

void summary(const char* name, std::vector<double> errors, std::size_t frames) {
  if (errors.empty()) {
    fmt::print("{}: none of {} frames\n", name, frames);
    return;
  }
  std::sort(errors.begin(), errors.end());
  const auto within = std::count_if(errors.begin(), errors.end(), [](double e) { return e <= 20; });
  const std::size_t half = errors.size() / 2;
  const double median = errors.size() % 2 ? errors[half] : (errors[half - 1] + errors[half]) / 2;
  fmt::print("{}: {} of {} frames, median azimuth error {:.1f}°, {} within 20° ({:.0f} %)\n", name,
             errors.size(), frames, median, within,
             100.0 * static_cast<double>(within) / static_cast<double>(errors.size()));
}

void study(const std::filesystem::path& data) {
  std::vector<double> known, all;
  const auto frames = list_frames(data);
  for (const std::string& id : frames) {
    const auto truth_file = data / "training/lighting" / (id + ".json");
    if (!std::filesystem::exists(truth_file))
      throw InputError(truth_file.string(), "to_sun_velo", "missing", "give a set of mirage generate");
    const Frame frame = read_frame(data, id);
    const SunEstimate estimate = sun_from_shadows(frame);
    const Vec3d &truth = frame.lighting.to_sun_velo, &guess = estimate.to_sun_velo;
    const double true_azimuth = std::atan2(truth.y(), truth.x()) / kDegree;
    const double azimuth = std::atan2(guess.y(), guess.x()) / kDegree;
    const double error = std::abs(std::remainder(azimuth - true_azimuth, 360));
    const Vec3d sky = frame.lighting.ambient + frame.lighting.hemisphere;
    fmt::print(
        "{} {} error {:5.1f}° of azimuth {:6.1f}°, {:+5.1f}° of elevation {:4.1f}°; contrast {:.2f}, score "
        "{:6.2f}, "
        "confidence {:.2f}, {} vehicles; sun/sky {:.2f}\n",
        id, estimate.known ? "known  " : "unknown", error, true_azimuth,
        (std::asin(guess.z()) - std::asin(truth.z())) / kDegree, std::asin(truth.z()) / kDegree,
        estimate.contrast, estimate.score, estimate.confidence, estimate.vehicles,
        frame.lighting.sun.y() * truth.z() / sky.y());
    if (estimate.known) known.push_back(error);
    if (estimate.score > 0) all.push_back(error);
  }
  summary("known", known, frames.size());
  summary("with a guess", all, frames.size());
}

}  // namespace
}  // namespace mirage

int main(int count, char** arguments) {
  if (count != 2) {
    std::fputs("usage: mirage_sun_study DATA\n", stderr);
    return 2;
  }
  try {
    mirage::study(arguments[1]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
  return 0;
}
