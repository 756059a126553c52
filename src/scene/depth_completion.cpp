#include "scene/depth_completion.h"

#include <cmath>
#include <opencv2/imgproc.hpp>

namespace mirage {
namespace {

// IP-Basic's constants (Ku et al., CRV 2018, section III).
constexpr float kMaxDepth = 100;  // depths are inverted about it, so that dilation prefers near surfaces
constexpr float kEmpty = 0.1f;    // inverted values below this are holes

cv::Mat diamond5() {
  return (cv::Mat_<unsigned char>(5, 5) << 0, 0, 1, 0, 0, 0, 1, 1, 1, 0, 1, 1, 1, 1, 1, 0, 1, 1, 1, 0, 0, 0,
          1, 0, 0);
}

cv::Mat square(int size) {
  return cv::Mat::ones(size, size, CV_8U);
}

/// Fills holes below the topmost filled pixel of each column with the dilation's values.
void fill_holes(cv::Mat& depth, int size) {
  cv::Mat dilated;
  cv::dilate(depth, dilated, square(size));
  for (int u = 0; u < depth.cols; ++u) {
    bool below_top = false;
    for (int v = 0; v < depth.rows; ++v) {
      float& value = depth.at<float>(v, u);
      if (value > kEmpty)
        below_top = true;
      else if (below_top)
        value = dilated.at<float>(v, u);
    }
  }
}

}  // namespace

ImageF sparse_depth(const Sweep& sweep, const Calibration& calibration) {
  const PinholeCamera& camera = calibration.camera;
  ImageF depth(camera.width, camera.height, 1);
  for (const LidarPoint& point : sweep) {
    const Vec3d p = calibration.camera_from_velo * point.position().cast<double>();
    if (!(p.z() > 0.1)) continue;
    const Vec2d pixel = camera.project(p);
    const long u = std::lround(pixel.x()), v = std::lround(pixel.y());
    if (u < 0 || v < 0 || u >= camera.width || v >= camera.height) continue;
    float& value = depth.at(static_cast<int>(u), static_cast<int>(v));
    if (value == 0 || p.z() < value) value = static_cast<float>(p.z());
  }
  return depth;
}

ImageF complete_depth(const ImageF& sparse) {
  cv::Mat depth(sparse.height, sparse.width, CV_32F, cv::Scalar(0));
  for (int v = 0; v < sparse.height; ++v)
    for (int u = 0; u < sparse.width; ++u)
      if (const float value = sparse.at(u, v); value > 0 && value < kMaxDepth)
        depth.at<float>(v, u) = kMaxDepth - value;
  cv::dilate(depth, depth, diamond5());
  cv::morphologyEx(depth, depth, cv::MORPH_CLOSE, square(5));
  cv::Mat dilated;
  cv::dilate(depth, dilated, square(7));
  dilated.copyTo(depth, depth < kEmpty);
  fill_holes(depth, 31);
  cv::Mat smooth;
  cv::medianBlur(depth, smooth, 5);
  cv::Mat blurred;
  cv::GaussianBlur(smooth, blurred, cv::Size(5, 5), 0);
  blurred.copyTo(smooth, smooth > kEmpty);

  ImageF dense(sparse.width, sparse.height, 1, kFarDepth);
  for (int v = 0; v < sparse.height; ++v)
    for (int u = 0; u < sparse.width; ++u)
      if (const float value = smooth.at<float>(v, u); value > kEmpty) dense.at(u, v) = kMaxDepth - value;
  return dense;
}

}  // namespace mirage
