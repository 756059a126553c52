// The exact interval of a share of independent trials.
#pragma once

namespace mirage {

/// Bounds of a share, in [0, 1].
struct BinomialInterval {
  double low = 0, high = 1;
};

/// Clopper and Pearson (Biometrika 1934): the quantiles (1 − confidence)/2 of Beta(k, n − k + 1) and
/// (1 + confidence)/2 of Beta(k + 1, n − k) for k successes in n > 0 trials. k need not be whole: the Beta
/// distributions are then the interval's continuation between whole ones. 0 ≤ k ≤ n.
BinomialInterval binomial_interval(double successes, double trials, double confidence = 0.95);

/// I_x(a, b), the share of Beta(a, b) below x in [0, 1], by its continued fraction (DLMF 8.17.22). a, b > 0.
double regularized_beta(double x, double a, double b);

}  // namespace mirage
