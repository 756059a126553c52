// Expectation over transformation (Athalye et al., Synthesizing Robust Adversarial Examples, ICML 2018): each
// simulated host of an attack gets a new draw of the uncertain world, so the mesh works in all of them.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "base/fields.h"
#include "base/random.h"
#include "simulation/insertion.h"

namespace mirage {

/// Upper limit of EotSettings::paints.
inline constexpr double kMaxPaints = 1000;
/// Upper limit of EotSettings::worst.
inline constexpr double kMaxWorstDraws = 64;

/// Spread of each random variation (standard deviation of a normal draw; 0: no variation).
struct EotSettings {
  double roof_shift = 0;   ///< m, along and across the roof; height a fifth of it
  double roof_yaw = 0;     ///< rad
  double sun = 0;          ///< rad, how far the sun turns away, to any side (never below 3° of altitude)
  double light = 0;        ///< of the logarithms of sun and of ambient and hemisphere together
  double exposure = 0;     ///< of the logarithm of the photograph's exposure, object included; white clips
  double image_noise = 0;  ///< of each channel of each pixel (scene-linear)
  double range_noise = 0;  ///< m, of the object's returns
  double tilt = 0;         ///< rad, about both horizontal axes of the roof
  double shape = 0;   ///< m, rms distance of a vertex of the object from its design: prints, scans, dents
  double colour = 0;  ///< of the logarithm of each channel of all texels: a print's cast; white clips
  /// Number of colours of the whole object (at most kMaxPaints): texels are clustered into as many, and each
  /// gets its cluster's mean. 0: any colour.
  double paints = 0;
  /// Draws for each host and step (at most kMaxWorstDraws), of which the step uses the one with the greatest
  /// loss. This samples the inner maximum of Madry et al., ICLR 2018, as R-PGA (2026) mines it. 0: one draw,
  /// so steps average over draws.
  double worst = 0;

  /// Whether anything is drawn.
  bool any() const;
  /// Whether the object differs from its design (SampledEnvironment::built).
  bool any_in_object() const { return shape > 0 || colour > 0 || paints > 0; }
  /// Whether the frame itself changes (SampledEnvironment::frame).
  bool any_in_frame() const { return sun > 0 || light > 0 || exposure > 0; }
  /// Whether pixels differ from the recorded ones away from the object.
  bool any_in_picture() const { return exposure > 0 || image_noise > 0; }
  /// Number of candidate draws for the worst; 1: no choice.
  int draws() const { return worst > 1 ? static_cast<int>(worst) : 1; }
};

template <class Visitor, FieldsOf<EotSettings> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "roof_shift", .range = {0, 10}}, s.roof_shift);
  visit({.name = "roof_yaw", .range = {0, 10}}, s.roof_yaw);
  visit({.name = "sun", .range = {0, 10}}, s.sun);
  visit({.name = "light", .range = {0, 10}}, s.light);
  visit({.name = "exposure", .range = {0, 10}}, s.exposure);
  visit({.name = "image_noise", .range = {0, 10}}, s.image_noise);
  visit({.name = "range_noise", .range = {0, 10}}, s.range_noise);
  visit({.name = "tilt", .range = {0, 10}, .lacking = "0"}, s.tilt);
  visit({.name = "shape", .range = {0, 10}, .lacking = "0"}, s.shape);
  visit({.name = "colour", .range = {0, 10}, .lacking = "0"}, s.colour);
  visit({.name = "paints", .range = {0, kMaxPaints}, .lacking = "0"}, s.paints);
  visit({.name = "worst", .range = {0, kMaxWorstDraws}, .lacking = "0"}, s.worst);
}

/// "none", or words of roof, tilt, shape, colour, sun, light, exposure, noise separated by commas, or "all".
/// They stand for 5 cm and 2°, 2°, 1 cm, 0.15, 20°, 0.3, 0.2, 0.01 and 2 cm. "shape:0.02" is a shape off by 2
/// cm, also with "all"; "paints:24" an object of 24 colours. "worst:4" with other words learns on the worst
/// of 4 draws. FieldError for any other word, a repeated word, and "none" with others. run_attack refuses
/// "worst" if nothing varies.
EotSettings parse_expectation(const std::string& words);
/// parse_expectation, with its errors.
inline void set_from_text(const std::string& text, EotSettings& value) {
  value = parse_expectation(text);
}
/// FieldError for words that only an attack understands (worst): an evaluation uses one draw.
void require_judged(const EotSettings& expectation);
/// FieldError for words that change more than the object and its pose (sun, light, exposure, noise), and for
/// worst: a renderer draws the recorded world with the object as manufactured.
void require_built(const EotSettings& expectation);
/// The number of candidate draw k (from 0) for draw `number` (below 2^50, or that plus 2^62). It is unique:
/// no other candidate and no plain draw has it.
constexpr std::uint64_t candidate_draw(std::uint64_t number, int k) {
  return number + (std::uint64_t{1} << 61) + (static_cast<std::uint64_t>(k) << 50);
}
/// "none", or "some".
std::string text_of(const EotSettings& value);

/// One random draw of the world around a host, from the random stream of (seed, draw).
class SampledEnvironment {
 public:
  /// Draw number `draw` of the attack's seed.
  SampledEnvironment(const EotSettings& expectation, std::uint64_t seed, std::uint64_t draw);

  /// The spreads of the draws.
  const EotSettings& expectation() const { return expectation_; }
  /// The number of this draw.
  std::uint64_t number() const { return draw_; }
  /// The object's pose, shifted and turned together with the roof under it.
  Placement placement(const Placement& as_recorded) const;
  /// The frame under another light and exposure.
  PreparedFrame frame(const PreparedFrame& as_recorded) const;
  /// The settings with the range noise of the object's returns.
  SimulationSettings simulation(const SimulationSettings& as_recorded) const;
  /// The object as manufactured: displaced vertices, few colours, a colour cast.
  TexturedMesh built(const TexturedMesh& designed) const;
  /// Turns d loss / d built into d loss / d designed, with the colour clusters of texels held fixed.
  void built_vjp(const TexturedMesh& designed, AdversaryGradient& gradient) const;
  /// Adds camera noise to the picture with the object, and clips it to [0, 1].
  void add_noise(ImageF& image) const;
  /// Turns d loss / d `noisy` (the output of add_noise) into d loss / d its input, both H×W×3: zero where it
  /// clipped. An empty gradient (the detector reads no picture) stays empty.
  void noise_vjp(const ImageF& noisy, ImageF& gradient) const;

 private:
  /// The drawn colour cast: one factor per channel, for all texels.
  Vec3d cast() const;

  EotSettings expectation_;
  std::uint64_t seed_, draw_;
};

/// One host in a drawn world, or as recorded without a draw. Its arguments must outlive it.
class SampledHost {
 public:
  /// `draw`: null for the world as recorded.
  SampledHost(const SampledEnvironment* draw, const PreparedFrame& recorded, const Placement& placement,
              const TexturedMesh& designed, const SimulationSettings& simulation);
  SampledHost(const SampledHost&) = delete;
  SampledHost& operator=(const SampledHost&) = delete;

  /// The frame in the draw's light and exposure, or the recorded frame if the draw changes neither.
  const PreparedFrame& prepared() const { return frame_ ? *frame_ : recorded_; }
  /// The object as manufactured in the draw, or as designed if the draw does not change it.
  const TexturedMesh& object() const { return built_ ? *built_ : designed_; }
  /// The object's pose in the draw.
  const Placement& placement() const { return placement_; }
  /// The settings with the draw's range noise.
  const SimulationSettings& simulation() const { return simulation_; }
  /// Turns d loss / d object() into d loss / d designed.
  void vjp(AdversaryGradient& gradient) const;

 private:
  const SampledEnvironment* draw_;
  const PreparedFrame& recorded_;
  const TexturedMesh& designed_;
  std::optional<PreparedFrame> frame_;
  std::optional<TexturedMesh> built_;
  Placement placement_;
  SimulationSettings simulation_;
};

}  // namespace mirage
