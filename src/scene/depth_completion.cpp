#include "scene/depth_completion.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "base/sizes.h"

namespace mirage {
namespace {

// IP-Basic's constants (Ku et al., CRV 2018, section III, and the authors' code for the multi-scale variant).
constexpr float kMaxDepth = 100;  // depths are inverted about it: dilation prefers near surfaces
constexpr float kEmpty = 0.1f;    // inverted values below this are holes
constexpr float kNearLimit = 15, kMiddleLimit = 30;  // m

cv::Mat square(int size) {
  return cv::Mat::ones(size, size, CV_8U);
}

cv::Mat diamond5() {
  return (cv::Mat_<unsigned char>(5, 5) << 0, 0, 1, 0, 0, 0, 1, 1, 1, 0, 1, 1, 1, 1, 1, 0, 1, 1, 1, 0, 0, 0,
          1, 0, 0);
}

/// First filled row of each column; the number of rows for an empty column.
std::vector<int> top_rows(const cv::Mat& depth) {
  std::vector<int> tops(as_size(depth.cols), depth.rows);
  for (int v = depth.rows; v-- > 0;)
    for (int u = 0; u < depth.cols; ++u)
      if (depth.at<float>(v, u) > kEmpty) tops[as_size(u)] = v;
  return tops;
}

/// Fills holes on or below `tops` by a dilation with a square of `size`.
void fill_holes(cv::Mat& depth, const std::vector<int>& tops, int size) {
  cv::Mat dilated;
  cv::dilate(depth, dilated, square(size));
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u)
      if (float& value = depth.at<float>(v, u); !(value > kEmpty) && v >= tops[as_size(u)])
        value = dilated.at<float>(v, u);
}

/// Repeats the topmost value of each column upwards.
void extrapolate_upwards(cv::Mat& depth, std::vector<int>& tops) {
  for (int u = 0; u < depth.cols; ++u) {
    int& top = tops[as_size(u)];
    if (top == depth.rows) continue;
    for (int v = 0; v < top; ++v) depth.at<float>(v, u) = depth.at<float>(top, u);
    top = 0;
  }
}

/// Replaces filled pixels by their blurred values.
void blur_filled(cv::Mat& depth, IpBasicOptions::Blur blur, double depth_sigma) {
  cv::Mat blurred;
  if (blur == IpBasicOptions::Blur::gaussian)
    cv::GaussianBlur(depth, blurred, cv::Size(5, 5), 0);
  else
    cv::bilateralFilter(depth, blurred, 5, depth_sigma, 2.0);
  blurred.copyTo(depth, depth > kEmpty);
}

cv::Mat inverted(const ImageF& sparse, float from, float to) {
  cv::Mat depth(sparse.height, sparse.width, CV_32F, cv::Scalar(0));
  for (int v = 0; v < sparse.height; ++v)
    for (int u = 0; u < sparse.width; ++u)
      if (const float value = sparse.at(u, v); value > from && value <= to && value < kMaxDepth)
        depth.at<float>(v, u) = kMaxDepth - value;
  return depth;
}

cv::Mat single_scale(const ImageF& sparse, const IpBasicOptions& options) {
  cv::Mat depth = inverted(sparse, 0, kMaxDepth);
  cv::dilate(depth, depth, diamond5());
  cv::morphologyEx(depth, depth, cv::MORPH_CLOSE, square(5));
  cv::Mat dilated;
  cv::dilate(depth, dilated, square(7));
  dilated.copyTo(depth, depth < kEmpty);
  std::vector<int> tops = top_rows(depth);
  if (options.extrapolate) extrapolate_upwards(depth, tops);
  fill_holes(depth, tops, 31);
  cv::Mat smooth;
  cv::medianBlur(depth, smooth, 5);
  blur_filled(smooth, options.blur, 1.5);
  return smooth;
}

cv::Mat multi_scale(const ImageF& sparse, const IpBasicOptions& options) {
  // Near values overwrite far ones where their dilations meet.
  cv::Mat depth(sparse.height, sparse.width, CV_32F, cv::Scalar(0));
  const struct {
    float from, to;
    int kernel;
  } bins[] = {{kMiddleLimit, kMaxDepth, 3}, {kNearLimit, kMiddleLimit, 5}, {0, kNearLimit, 7}};
  for (const auto& bin : bins) {
    cv::Mat dilated = inverted(sparse, bin.from, bin.to);
    cv::dilate(dilated, dilated,
               cv::getStructuringElement(cv::MORPH_CROSS, cv::Size(bin.kernel, bin.kernel)));
    dilated.copyTo(depth, dilated > kEmpty);
  }
  cv::morphologyEx(depth, depth, cv::MORPH_CLOSE, square(5));
  cv::Mat median;
  cv::medianBlur(depth, median, 5);
  median.copyTo(depth, depth > kEmpty);
  fill_holes(depth, top_rows(depth), 9);
  std::vector<int> tops = top_rows(depth);
  if (options.extrapolate) extrapolate_upwards(depth, tops);
  for (int i = 0; i < 6; ++i) fill_holes(depth, tops, 5);
  cv::medianBlur(depth, median, 5);
  median.copyTo(depth, depth > kEmpty);
  blur_filled(depth, options.blur, 0.5);
  return depth;
}

/// Fills the gaps of a line of `count` values, `step` apart; with `inner`, only gaps between two values.
void fill_line(float* line, int count, int step, bool inner) {
  const auto at = [&](int i) -> float& { return line[static_cast<std::ptrdiff_t>(i) * step]; };
  int last = -1;  // the last value seen
  for (int i = 0; i < count; ++i) {
    if (at(i) >= kFarDepth) continue;
    if (last < 0) {
      for (int k = 0; k < i; ++k) at(k) = at(i);
    } else if (inner) {
      const float nearer = std::min(at(last), at(i));
      for (int k = last + 1; k < i; ++k) at(k) = nearer;
    }
    last = i;
  }
  if (last >= 0)
    for (int k = last + 1; k < count; ++k) at(k) = at(last);
}

}  // namespace

ImageF sparse_depth(const Sweep& sweep, const Calibration& calibration) {
  const PinholeCamera& camera = calibration.camera;
  ImageF depth(camera.width, camera.height, 1);
  for (const LidarPoint& point : sweep) {
    const Vec3d p = calibration.camera_from_velo * point.position().cast<double>();
    if (!p.allFinite() || !(p.z() > 0.1)) continue;
    const Vec2d pixel = camera.project(p);
    if (!(pixel.cwiseAbs().maxCoeff() < 1e6)) continue;
    const long u = std::lround(pixel.x()), v = std::lround(pixel.y());
    if (u < 0 || v < 0 || u >= camera.width || v >= camera.height) continue;
    float& value = depth.at(static_cast<int>(u), static_cast<int>(v));
    if (value == 0 || p.z() < value) value = static_cast<float>(p.z());
  }
  return depth;
}

std::string IpBasic::name() const {
  return std::string("ip-basic") + (options_.multi_scale ? "-multiscale" : "") +
         (options_.blur == IpBasicOptions::Blur::bilateral ? "-bilateral" : "") +
         (options_.extrapolate ? "-extrapolated" : "");
}

ImageF IpBasic::complete(const ImageF&, const ImageF& sparse) const {
  ImageF dense(sparse.width, sparse.height, 1, kFarDepth);
  if (sparse.empty()) return dense;
  const cv::Mat depth = options_.multi_scale ? multi_scale(sparse, options_) : single_scale(sparse, options_);
  for (int v = 0; v < sparse.height; ++v)
    for (int u = 0; u < sparse.width; ++u)
      if (const float value = depth.at<float>(v, u); value > kEmpty) dense.at(u, v) = kMaxDepth - value;
  return dense;
}

ImageF complete_depth(const ImageF& sparse) {
  return IpBasic().complete({}, sparse);
}

DepthErrors depth_errors(const ImageF& truth, const ImageF& dense, double farthest,
                         const Image<std::uint8_t>& where) {
  DepthErrors e;
  double squares = 0, absolute = 0, inverse_squares = 0, inverse_absolute = 0;
  for (std::size_t i = 0; i < truth.data.size(); ++i) {
    const double t = truth.data[i], d = dense.data[i];
    if (!(t > 0) || t > farthest || (!where.empty() && !where.data[i])) continue;
    const double error = std::abs(d - t), inverse = std::abs(1 / d - 1 / t);
    squares += error * error;
    absolute += error;
    inverse_squares += inverse * inverse;
    inverse_absolute += inverse;
    ++e.pixels;
  }
  if (e.pixels == 0) return e;
  const double n = static_cast<double>(e.pixels);
  e.rmse = 1e3 * std::sqrt(squares / n);
  e.mae = 1e3 * absolute / n;
  e.irmse = 1e3 * std::sqrt(inverse_squares / n);
  e.imae = 1e3 * inverse_absolute / n;
  return e;
}

void MeanDepthErrors::add(const DepthErrors& errors) {
  if (errors.pixels == 0) return;
  ++pictures_;
  sum_.rmse += errors.rmse;
  sum_.mae += errors.mae;
  sum_.irmse += errors.irmse;
  sum_.imae += errors.imae;
  sum_.pixels += errors.pixels;
}

DepthErrors MeanDepthErrors::mean() const {
  DepthErrors mean = sum_;
  const double n = std::max(1, pictures_);
  for (double* value : {&mean.rmse, &mean.mae, &mean.irmse, &mean.imae}) *value /= n;
  return mean;
}

ImageF fill_as_benchmark(const ImageF& dense) {
  ImageF filled = dense;
  for (int v = 0; v < dense.height; ++v) fill_line(filled.pixel(0, v), dense.width, 1, true);
  for (int u = 0; u < dense.width; ++u) fill_line(filled.pixel(u, 0), dense.height, dense.width, false);
  return filled;
}

}  // namespace mirage
