#include "base/binomial.h"

#include <cmath>
#include <initializer_list>
#include <limits>

namespace mirage {
namespace {

/// The x with I_x(a, b) = share.
double beta_quantile(double share, double a, double b) {
  double low = 0, high = 1;
  for (int i = 0; i < 60; ++i) {
    const double middle = (low + high) / 2;
    (regularized_beta(middle, a, b) < share ? low : high) = middle;
  }
  return (low + high) / 2;
}

}  // namespace

double regularized_beta(double x, double a, double b) {
  if (!(x > 0)) return 0;
  if (!(x < 1)) return 1;
  if (x > (a + 1) / (a + b + 2)) return 1 - regularized_beta(1 - x, b, a);  // there it converges faster
  const double front =
      std::exp(std::lgamma(a + b) - std::lgamma(a) - std::lgamma(b) + a * std::log(x) + b * std::log1p(-x)) /
      a;
  // Lentz's method; tiny stands in for a denominator of 0.
  constexpr double kTiny = 1e-300;
  const auto not_zero = [](double value) { return std::abs(value) < kTiny ? kTiny : value; };
  double c = 1, d = 1 / not_zero(1 - (a + b) * x / (a + 1)), fraction = d;
  for (int m = 1; m < 500; ++m) {
    double change = 1;
    for (const double term : {m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
                              -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))}) {
      d = 1 / not_zero(1 + term * d);
      c = not_zero(1 + term / c);
      change = c * d;
      fraction *= change;
    }
    if (std::abs(change - 1) < 4 * std::numeric_limits<double>::epsilon()) break;
  }
  return front * fraction;
}

BinomialInterval binomial_interval(double successes, double trials, double confidence) {
  const double tail = (1 - confidence) / 2;
  // None and all have closed forms.
  const double unseen = 1 - std::pow(tail, 1 / trials);
  BinomialInterval result;
  if (successes >= trials)
    result.low = 1 - unseen;
  else if (successes > 0)
    result.low = beta_quantile(tail, successes, trials - successes + 1);
  if (successes <= 0)
    result.high = unseen;
  else if (successes < trials)
    result.high = beta_quantile(1 - tail, successes + 1, trials - successes);
  return result;
}

}  // namespace mirage
