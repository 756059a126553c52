#include "validation/fidelity/picture_errors.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "base/color.h"
#include "base/error.h"

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
  const std::size_t pixels = static_cast<std::size_t>(image.width) * image.height;
  for (std::size_t i = 0; i < pixels; ++i)
    if (mask.empty() || mask.data[i * mask.channels] > 0.5f) {
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
      sum += term(static_cast<double>(a.data[i * a.channels + c]) - b.data[i * a.channels + c]);
  });
  return n == 0 ? 0 : sum / (static_cast<double>(n) * a.channels);
}

}  // namespace

double mean_absolute_error(const ImageF& a, const ImageF& b, const ImageF& mask) {
  return mean_term(a, b, mask, [](double d) { return std::abs(d); });
}

double relative_error(const ImageF& from, const ImageF& to, const ImageF& mask) {
  const double mean = mean_absolute_error(from, ImageF(from.width, from.height, from.channels), mask);
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
  for (std::size_t i = 0; i < out.data.size(); ++i) out.data[i] = luminance(&rgb.data[i * rgb.channels]);
  return out;
}

ImageF encoded(const ImageF& linear) {
  ImageF out = linear;
  for (float& value : out.data) value = srgb_from_linear(value);
  return out;
}

}  // namespace mirage
