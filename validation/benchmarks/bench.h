// What the files of the benchmark program share.
#pragma once

#include <functional>
#include <nlohmann/json.hpp>
#include <vector>

namespace mirage {

/// Figures other than the median time of one loop, such as ratios of medians taken in alternation, by name;
/// written to bench.json beside the medians.
nlohmann::json& extra_figures();

/// Wall-clock time of work().
double milliseconds(const std::function<void()>& work);
double median(std::vector<double> values);

/// The soft rasteriser: distance, faces, pixels, threads; against the plain loop and the machine's peak.
void register_raster_benchmarks();
/// One insertion as a whole and by stage.
void register_insertion_benchmarks();
/// Sweep tracing against a bare Embree loop, the LiDAR part of an insertion, the sweep's index.
void register_lidar_benchmarks();
/// The vehicle fit by stage.
void register_fit_benchmarks();
/// The street generator: frames a second and the share of each stage, for both rigs.
void register_generator_benchmarks();
/// Detectors: passes and training steps, by stage.
void register_detector_benchmarks();
/// One host's attack step, over whole frames and over windows.
void register_attack_step_benchmarks();
/// A detector in another process: the way there and back.
void register_process_benchmarks();

}  // namespace mirage
