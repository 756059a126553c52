// Shared code of the benchmark program's files.
#pragma once

#include <benchmark/benchmark.h>

#include <algorithm>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "base/intervals.h"
#include "base/schedule.h"
#include "validation/thread_clock.h"

/// A benchmark that goes through its rounds itself: ONCE(BENCHMARK(function));
#define ONCE(registered) registered->Iterations(1)->Unit(benchmark::kMillisecond)

namespace mirage {

/// Figures other than the median time of one loop, such as ratios of medians taken in alternation, by name;
/// written to bench.json beside the medians.
nlohmann::json& figures();

/// Wall-clock time of work().
template <class Work>
double milliseconds(const Work& work) {
  const auto start = Clock::now();
  work();
  return 1e3 * seconds_since(start);
}

/// Values by name, one a round: compared values are taken in alternation.
class Rounds {
 public:
  double add(const std::string& name, double value) { return values_[name].emplace_back(value); }
  /// ms of work() on the wall's clock, or of this thread's CPU.
  template <class Work>
  double time(const std::string& name, const Work& work) {
    return add(name, milliseconds(work));
  }
  template <class Work>
  double cpu(const std::string& name, const Work& work) {
    return add(name, cpu_ms(work));
  }
  std::size_t count(const std::string& name) const { return values_.at(name).size(); }
  double least(const std::string& name) const { return *std::ranges::min_element(values_.at(name)); }
  double at(const std::string& name, double share) const { return lower_quantile(values_.at(name), share); }
  /// The median.
  double operator[](const std::string& name) const { return at(name, 0.5); }
  /// Median over the rounds of a − b.
  double difference(const std::string& a, const std::string& b) const {
    Rounds rounds;
    for (std::size_t i = 0; i < count(a); ++i) rounds.add("", values_.at(a)[i] - values_.at(b)[i]);
    return rounds[""];
  }
  /// Records all medians as figures, by name and suffix.
  void record(const std::string& suffix = "") const {
    for (const auto& [name, values] : values_) figures()[name + suffix] = (*this)[name];
  }

 private:
  std::map<std::string, std::vector<double>> values_;
};

}  // namespace mirage
