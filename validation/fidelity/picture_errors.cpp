#include "validation/fidelity/picture_errors.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "base/error.h"
#include "base/sizes.h"
#include "base/types.h"

namespace mirage {
namespace {

void check_sizes(const ImageF& a, const ImageF& b, const ImageF& mask) {
  const bool same = a.width == b.width && a.height == b.height && a.channels == b.channels;
  if (!same || (!mask.empty() && (mask.width != a.width || mask.height != a.height)))
    throw Failure("fidelity", "images of different size", "report this as a bug");
}

/// Calls body(pixel index) for the pixels that count; returns how many.
template <class Body>
std::size_t for_pixels(const ImageF& image, const ImageF& mask, const Body& body) {
  std::size_t count = 0;
  const std::size_t pixels = as_size(image.width) * as_size(image.height);
  for (std::size_t i = 0; i < pixels; ++i)
    if (mask.empty() || mask.data[i * as_size(mask.channels)] > 0.5f) {
      body(i);
      ++count;
    }
  return count;
}

template <class Term>
double mean_term(const ImageF& a, const ImageF& b, const ImageF& mask, const Term& term) {
  check_sizes(a, b, mask);
  double sum = 0;
  const std::size_t n = for_pixels(a, mask, [&](std::size_t i) {
    for (int c = 0; c < a.channels; ++c)
      sum += term(static_cast<double>(a.data[i * as_size(a.channels) + as_size(c)]) -
                  b.data[i * as_size(a.channels) + as_size(c)]);
  });
  return n == 0 ? 0 : sum / (static_cast<double>(n) * a.channels);
}

// FLIP for low dynamic range (Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild: "FLIP: A
// Difference Evaluator for Alternating Images", HPG 2020). Section numbers are the paper's.

using Planes = std::array<cv::Mat, 3>;  // CV_64F, one a channel

const Eigen::Matrix3d kXyzFromLinear = (Eigen::Matrix3d() << 0.4124564, 0.3575761, 0.1804375,  //
                                        0.2126729, 0.7151522, 0.0721750,                       //
                                        0.0193339, 0.1191920, 0.9503041)
                                           .finished();
const Vec3d kWhite = kXyzFromLinear * Vec3d::Ones();
const Eigen::Matrix3d kLinearFromXyz = kXyzFromLinear.inverse();

constexpr double kPixelsPerDegree = 67.0206;  // 0.7 m before a 0.7 m wide 4K display
// Colour pipeline (section 4.1): exponent, and the knee of the error redistribution.
constexpr double kColorExponent = 0.7, kKneePlace = 0.4, kKneeValue = 0.95;
// Feature pipeline (section 4.2): width of the detectors (degrees) and exponent.
constexpr double kFeatureWidth = 0.082, kFeatureExponent = 0.5;

/// Linearised CIELAB: (Y, Cx, Cz).
Vec3d ycxcz_from_linear(const Vec3d& linear) {
  const Vec3d r = (kXyzFromLinear * linear).cwiseQuotient(kWhite);
  return {116 * r.y() - 16, 500 * (r.x() - r.y()), 200 * (r.y() - r.z())};
}

Vec3d linear_from_ycxcz(const Vec3d& c) {
  const double y = (c.x() + 16) / 116;
  return kLinearFromXyz * Vec3d(y + c.y() / 500, y, y - c.z() / 200).cwiseProduct(kWhite);
}

/// CIELAB with the Hunt effect: chroma counts for less in the dark.
Vec3d hunt_lab(const Vec3d& linear) {
  constexpr double kDelta = 6.0 / 29;
  const auto f = [](double t) {
    return t > kDelta * kDelta * kDelta ? std::cbrt(t) : t / (3 * kDelta * kDelta) + 4.0 / 29;
  };
  const Vec3d r = (kXyzFromLinear * linear).cwiseQuotient(kWhite);
  const double fx = f(r.x()), fy = f(r.y()), fz = f(r.z()), lightness = 116 * fy - 16;
  return {lightness, 0.01 * lightness * 500 * (fx - fy), 0.01 * lightness * 200 * (fy - fz)};
}

double hyab(const Vec3d& a, const Vec3d& b) {
  const Vec3d d = a - b;
  return std::abs(d.x()) + std::hypot(d.y(), d.z());
}

Planes planes(const ImageF& image) {
  Planes result;
  for (auto& plane : result) plane.create(image.height, image.width, CV_64F);
  for (int v = 0; v < image.height; ++v)
    for (int u = 0; u < image.width; ++u) {
      Vec3d linear;
      for (int c = 0; c < 3; ++c) linear[c] = linear_from_srgb(image.at(u, v, c));
      const Vec3d color = ycxcz_from_linear(linear);
      for (int c = 0; c < 3; ++c) result[as_size(c)].at<double>(v, u) = color[c];
    }
  return result;
}

cv::Mat filtered(const cv::Mat& in, const cv::Mat& kernel) {
  cv::Mat out;
  cv::filter2D(in, out, CV_64F, kernel, cv::Point(-1, -1), 0, cv::BORDER_REPLICATE);
  return out;
}

/// Contrast sensitivity of one opponent channel as a sum of two Gaussians (table 1 of the paper).
cv::Mat contrast_kernel(double a1, double b1, double a2, double b2) {
  constexpr double kPi = std::numbers::pi, kWidest = 0.04;
  const int radius = static_cast<int>(std::ceil(3 * std::sqrt(kWidest / (2 * kPi * kPi)) * kPixelsPerDegree));
  cv::Mat kernel(2 * radius + 1, 2 * radius + 1, CV_64F);
  for (int y = -radius; y <= radius; ++y)
    for (int x = -radius; x <= radius; ++x) {
      const double z = (x * x + y * y) / (kPixelsPerDegree * kPixelsPerDegree);
      kernel.at<double>(y + radius, x + radius) = a1 * std::sqrt(kPi / b1) * std::exp(-kPi * kPi * z / b1) +
                                                  a2 * std::sqrt(kPi / b2) * std::exp(-kPi * kPi * z / b2);
    }
  return kernel / cv::sum(kernel)[0];
}

Planes as_seen(const Planes& in) {
  return {filtered(in[0], contrast_kernel(1, 0.0047, 0, 1e-5)),
          filtered(in[1], contrast_kernel(1, 0.0053, 0, 1e-5)),
          filtered(in[2], contrast_kernel(34.1, 0.04, 13.5, 0.025))};
}

/// First (edges) or second (points) derivative of a Gaussian along x; positive and negative weights sum to
/// ±1.
cv::Mat feature_kernel(bool points) {
  const double sd = 0.5 * kFeatureWidth * kPixelsPerDegree;
  const int radius = static_cast<int>(std::ceil(3 * sd));
  cv::Mat kernel(2 * radius + 1, 2 * radius + 1, CV_64F);
  double positive = 0, negative = 0;
  for (int y = -radius; y <= radius; ++y)
    for (int x = -radius; x <= radius; ++x) {
      const double g = std::exp(-(x * x + y * y) / (2 * sd * sd));
      const double weight = points ? (x * x / (sd * sd) - 1) * g : -x * g;
      kernel.at<double>(y + radius, x + radius) = weight;
      (weight > 0 ? positive : negative) += std::abs(weight);
    }
  for (int i = 0; i < kernel.rows * kernel.cols; ++i) {
    double& weight = kernel.ptr<double>()[i];
    weight /= weight > 0 ? positive : negative;
  }
  return kernel;
}

cv::Mat feature_strength(const cv::Mat& lightness, bool points) {
  const cv::Mat along_x = feature_kernel(points);
  cv::Mat strength;
  cv::magnitude(filtered(lightness, along_x), filtered(lightness, along_x.t()), strength);
  return strength;
}

/// The error of each pixel.
ImageF flip_map(const ImageF& reference, const ImageF& test) {
  if (reference.width != test.width || reference.height != test.height || reference.channels != 3 ||
      test.channels != 3)
    throw Failure("flip", "images of different size or not RGB", "report this as a bug");
  ImageF result(reference.width, reference.height, 1);
  if (result.empty()) return result;
  const Planes a = planes(reference), b = planes(test);
  const Planes seen_a = as_seen(a), seen_b = as_seen(b);
  const cv::Mat light_a = (a[0] + 16) / 116, light_b = (b[0] + 16) / 116;
  std::array<cv::Mat, 2> feature_a, feature_b;
  for (std::size_t points = 0; points < 2; ++points) {
    feature_a[points] = feature_strength(light_a, points == 1);
    feature_b[points] = feature_strength(light_b, points == 1);
  }
  const double largest = std::pow(hyab(hunt_lab(Vec3d(0, 1, 0)), hunt_lab(Vec3d(0, 0, 1))), kColorExponent);
  const double knee = kKneePlace * largest;
  const auto lab = [](const Planes& p, int v, int u) {
    const Vec3d color(p[0].at<double>(v, u), p[1].at<double>(v, u), p[2].at<double>(v, u));
    return hunt_lab(linear_from_ycxcz(color).cwiseMax(0.0).cwiseMin(1.0));
  };
  for (int v = 0; v < result.height; ++v)
    for (int u = 0; u < result.width; ++u) {
      const double distance = std::pow(hyab(lab(seen_a, v, u), lab(seen_b, v, u)), kColorExponent);
      const double color = distance < knee
                               ? kKneeValue / knee * distance
                               : kKneeValue + (distance - knee) / (largest - knee) * (1 - kKneeValue);
      double change = 0;
      for (std::size_t points = 0; points < 2; ++points)
        change = std::max(change,
                          std::abs(feature_a[points].at<double>(v, u) - feature_b[points].at<double>(v, u)));
      const double feature = std::pow(change / std::numbers::sqrt2, kFeatureExponent);
      result.at(u, v) = static_cast<float>(std::pow(color, 1 - feature));
    }
  return result;
}

}  // namespace

double mean_absolute_error(const ImageF& a, const ImageF& b, const ImageF& mask) {
  return mean_term(a, b, mask, [](double d) { return std::abs(d); });
}

double mean_of(const ImageF& image, const ImageF& mask) {
  return mean_absolute_error(image, ImageF(image.width, image.height, image.channels), mask);
}

double relative_error(const ImageF& from, const ImageF& to, const ImageF& mask) {
  const double mean = mean_of(from, mask);
  return mean > 0 ? mean_absolute_error(from, to, mask) / mean : 0;
}

double max_absolute_error(const ImageF& a, const ImageF& b, const ImageF& mask) {
  double worst = 0;
  mean_term(a, b, mask, [&](double d) {
    worst = std::max(worst, std::abs(d));
    return 0.0;
  });
  return worst;
}

double mask_iou(const ImageF& a, const ImageF& b) {
  check_sizes(a, b, {});
  std::size_t both = 0, either = 0;
  for (std::size_t i = 0; i < a.data.size(); ++i) {
    const bool in_a = a.data[i] > 0.5f, in_b = b.data[i] > 0.5f;
    both += in_a && in_b;
    either += in_a || in_b;
  }
  return either == 0 ? 1 : static_cast<double>(both) / static_cast<double>(either);
}

double psnr(const ImageF& a, const ImageF& b, const ImageF& mask) {
  const double mse = mean_term(a, b, mask, [](double d) { return d * d; });
  return mse > 0 ? -10 * std::log10(mse) : std::numeric_limits<double>::infinity();
}

double ssim(const ImageF& a, const ImageF& b, const ImageF& mask) {
  check_sizes(a, b, mask);
  if (a.channels != 1) throw Failure("ssim", "takes 1-channel images", "report this as a bug");
  if (a.empty()) return 1;
  const auto wrap = [](const ImageF& image) {
    cv::Mat matrix;
    cv::Mat(image.height, image.width, CV_32F, const_cast<float*>(image.data.data()))
        .convertTo(matrix, CV_64F);
    return matrix;
  };
  const auto blur = [](const cv::Mat& in) {
    cv::Mat out;
    cv::GaussianBlur(in, out, cv::Size(11, 11), 1.5, 1.5, cv::BORDER_REFLECT);
    return out;
  };
  const cv::Mat x = wrap(a), y = wrap(b);
  const cv::Mat mx = blur(x), my = blur(y);
  const cv::Mat xx = blur(x.mul(x)), yy = blur(y.mul(y)), xy = blur(x.mul(y));
  constexpr double c1 = 0.01 * 0.01, c2 = 0.03 * 0.03;
  double sum = 0;
  const std::size_t n = for_pixels(a, mask, [&](std::size_t i) {
    const double ux = mx.at<double>(static_cast<int>(i)), uy = my.at<double>(static_cast<int>(i));
    const double vx = xx.at<double>(static_cast<int>(i)) - ux * ux,
                 vy = yy.at<double>(static_cast<int>(i)) - uy * uy;
    const double cov = xy.at<double>(static_cast<int>(i)) - ux * uy;
    sum += (2 * ux * uy + c1) * (2 * cov + c2) / ((ux * ux + uy * uy + c1) * (vx + vy + c2));
  });
  return n == 0 ? 1 : sum / static_cast<double>(n);
}

ImageF grey(const ImageF& rgb) {
  ImageF out(rgb.width, rgb.height, 1);
  for (std::size_t i = 0; i < out.data.size(); ++i)
    out.data[i] = luminance(&rgb.data[i * as_size(rgb.channels)]);
  return out;
}

ImageF encoded(const ImageF& linear) {
  ImageF out = linear;
  for (float& value : out.data) value = srgb_from_linear(value);
  return out;
}

double flip(const ImageF& reference, const ImageF& test, const ImageF& mask) {
  return mean_of(flip_map(reference, test), mask);
}

Change change(const ImageF& from, const ImageF& to, const ImageF& mask) {
  const ImageF seen_from = encoded(from), seen = encoded(to);
  Change result;
  result.mae = mean_absolute_error(from, to, mask);
  result.relative = relative_error(from, to, mask);
  result.psnr = psnr(from, to, mask);
  result.ssim = ssim(grey(seen_from), grey(seen), mask);
  result.flip = flip(seen_from, seen, mask);
  return result;
}

}  // namespace mirage
