// An attack on tiny frames whose detector looks through a renderer.
#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <memory>

#include "attack/attack.h"
#include "attack/tiny_world.h"
#include "base/files.h"
#include "support/files.h"

namespace mirage::test {

/// Three frames and one stand-in detector, for runs side by side.
class RenderedAttack {
 public:
  /// The renderer of the run in a folder; null: the rasteriser.
  using MakeRenderer = std::function<std::shared_ptr<ObjectRenderer>(const std::filesystem::path& out)>;

  RenderedAttack() {
    write_tiny_data(folder_ / "data", 3);
    detectors_.push_back(std::make_unique<StandInDetector>());
  }

  /// The folder of a run.
  std::filesystem::path out(const char* run) const { return folder_ / run; }

  /// Learns up to so many iterations, from the run's checkpoint if it has one. Its checkpoint then.
  nlohmann::json learn(const char* run, int iterations, const MakeRenderer& renderer) {
    AttackSettings settings = tiny_attack();
    settings.data = folder_ / "data";
    settings.out = out(run);
    settings.iterations = iterations;
    settings.vertex_rate = 5e-3;
    settings.rooftop = "box";
    settings.quiet = true;
    settings.renderer = renderer(settings.out);
    settings.renewal = {0.012, 0.05};
    run_attack(settings, detectors_);
    return read_json(settings.out / "checkpoint.json");
  }

  /// Expects that run "whole" of four iterations and one that stops after two of them end in the same bits.
  void expect_same_bits_in_parts(const MakeRenderer& renderer) {
    learn("parts", 2, renderer);
    learn("parts", 4, renderer);
    for (const char* file : {"adversary.glb", "loss.csv"})
      EXPECT_EQ(read_file(out("whole") / file), read_file(out("parts") / file)) << file;
  }

 private:
  TemporaryFolder folder_;
  DetectorPool detectors_;
};

}  // namespace mirage::test
