// The lowest of a function of many numbers, given its values alone: CMA-ES (Hansen, "The CMA Evolution
// Strategy: A Tutorial", arXiv 1604.00772), by pagmo.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

namespace mirage {

/// Numbers are drawn a generation at a time from a normal distribution, which moves to the better half of
/// them and takes their spread. What is drawn depends on the seed and on the values told, so that a search is
/// restored by telling it the same values again.
class Evolution {
 public:
  /// From zero, with standard deviation 1 at first; ≥ 5 `samples` a generation.
  Evolution(std::size_t numbers, int samples, std::uint64_t seed);
  ~Evolution();
  /// Where the function is to be looked at now.
  const std::vector<double>& next() const;
  /// The function there; finite.
  void add(double value);
  /// The distribution's mean: the better half of the last whole generation, weighted by rank.
  const std::vector<double>& centre() const { return centre_; }

 private:
  struct Method;
  void draw();

  std::unique_ptr<Method> method_;
  std::vector<double> centre_, values_;  // values of this generation, so far
  std::vector<std::vector<double>> generation_;
};

}  // namespace mirage
