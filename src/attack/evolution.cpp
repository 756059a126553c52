#include "attack/evolution.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <pagmo/algorithms/cmaes.hpp>
#include <pagmo/population.hpp>
#include <pagmo/problem.hpp>

#include "base/random.h"

namespace mirage {

struct Evolution::Method {
  /// What pagmo asks for within a generation, and what it is answered. It asks for all of a generation before
  /// it looks at any answer: so a copy of it, answered with zeros, tells what the next generation is.
  struct Questions {
    std::vector<std::vector<double>> asked;
    std::vector<double> answers;
  };
  /// The function as pagmo sees it.
  struct Answered {
    std::shared_ptr<Questions> questions;
    std::size_t numbers = 1;

    pagmo::vector_double fitness(const pagmo::vector_double& at) const {
      const std::size_t i = questions->asked.size();
      questions->asked.push_back(at);
      return {i < questions->answers.size() ? questions->answers[i] : 0};
    }
    /// pagmo's first standard deviations are their distances.
    std::pair<pagmo::vector_double, pagmo::vector_double> get_bounds() const {
      return {pagmo::vector_double(numbers, -0.5), pagmo::vector_double(numbers, 0.5)};
    }
  };

  Method(std::size_t numbers, std::uint64_t seed)
      : method(1, kOwn, kOwn, kOwn, kOwn, /*sigma0=*/1, /*ftol=*/0, /*xtol=*/0, /*memory=*/true,
               /*force_bounds=*/false, RandomStream(seed, "evolution").next_u32()),
        population(pagmo::problem(Answered{questions, numbers})) {}

  static constexpr double kOwn = -1;  // pagmo's rates
  std::shared_ptr<Questions> questions = std::make_shared<Questions>();
  pagmo::cmaes method;  // one generation a call
  pagmo::population population;
};

Evolution::Evolution(std::size_t numbers, int samples, std::uint64_t seed)
    : method_(std::make_unique<Method>(numbers, seed)), centre_(numbers, 0.0) {
  for (int i = 0; i < samples; ++i) method_->population.push_back(centre_, {0.0});
  draw();
}

Evolution::~Evolution() = default;

void Evolution::draw() {
  *method_->questions = {};
  const pagmo::cmaes copy = method_->method;
  copy.evolve(method_->population);
  generation_ = method_->questions->asked;
}

const std::vector<double>& Evolution::next() const {
  return generation_[values_.size()];
}

void Evolution::add(double value) {
  values_.push_back(value);
  if (values_.size() < generation_.size()) return;
  *method_->questions = {{}, values_};
  method_->population = method_->method.evolve(method_->population);
  std::vector<std::size_t> order(values_.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return values_[a] < values_[b]; });
  order.resize(order.size() / 2);  // pagmo keeps its mean to itself; this is how it is made
  double sum = 0;
  std::fill(centre_.begin(), centre_.end(), 0.0);
  for (std::size_t rank = 0; rank < order.size(); ++rank) {
    const double weight =
        std::log((static_cast<double>(order.size()) + 0.5) / (static_cast<double>(rank) + 1));
    sum += weight;
    for (std::size_t i = 0; i < centre_.size(); ++i) centre_[i] += weight * generation_[order[rank]][i];
  }
  for (double& x : centre_) x /= sum;
  values_.clear();
  draw();
}

}  // namespace mirage
