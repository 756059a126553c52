#include "detection/jpeg_detector.h"

#include <turbojpeg.h>

#include "base/error.h"
#include "base/srgb_bytes.h"
#include "detection/around.h"

namespace mirage {
namespace {

struct CloseTurboJpeg {
  void operator()(void* handle) const { tjDestroy(handle); }
};
using TurboJpeg = std::unique_ptr<void, CloseTurboJpeg>;

void check(int status, const TurboJpeg& handle) {
  if (status != 0)
    throw Failure("libjpeg-turbo", tjGetErrorStr2(handle.get()), "check the picture and the free memory");
}

class JpegDetector : public DetectorAround {
 public:
  JpegDetector(std::unique_ptr<Detector> inner, int quality)
      : DetectorAround(std::move(inner)), quality_(quality) {}

  Capabilities capabilities() const override {
    Capabilities known = inner_->capabilities();
    known.why_whole = "the pictures that it sees are compressed";
    return known;
  }

  std::vector<Detection> forward(const SensorView& input, double score_threshold, bool keep_graph) override {
    ImageF image;
    return inner_->forward(compressed(input, image), score_threshold, keep_graph);
  }

  TrainingLoss train_step(std::span<const TrainingSample> samples, double learning_rate) override {
    std::vector<ImageF> images(samples.size());
    std::vector<TrainingSample> seen(samples.begin(), samples.end());
    for (std::size_t i = 0; i < seen.size(); ++i) seen[i].input = compressed(samples[i].input, images[i]);
    return inner_->train_step(seen, learning_rate);
  }
  std::unique_ptr<Detector> share() override {
    auto other = inner_->share();
    return other ? behind_jpeg(std::move(other), quality_) : nullptr;
  }
  ImageFeatures image_features(const SensorView& input) override {
    ImageF image;
    return inner_->image_features(compressed(input, image));
  }

 private:
  /// The view with its picture compressed into `image`.
  SensorView compressed(SensorView view, ImageF& image) const {
    view.clean = nullptr;
    if (view.image == nullptr || view.image->empty()) return view;
    image = jpeg_round_trip(*view.image, quality_);
    view.image = &image;
    return view;
  }

  int quality_;
};

}  // namespace

std::string encode_jpeg(const ImageF& linear, int quality) {
  const TurboJpeg compressor(tjInitCompress());
  if (!compressor) throw Failure("libjpeg-turbo", "could not start", "check the free memory");
  const std::vector<std::uint8_t> bytes = srgb_bytes(linear);
  unsigned char* encoded = nullptr;
  unsigned long size = 0;
  const int status = tjCompress2(compressor.get(), bytes.data(), linear.width, 0, linear.height, TJPF_RGB,
                                 &encoded, &size, TJSAMP_420, quality, TJFLAG_ACCURATEDCT);
  const std::unique_ptr<unsigned char, void (*)(unsigned char*)> owner(encoded, tjFree);
  check(status, compressor);
  return {reinterpret_cast<const char*>(owner.get()), size};
}

ImageF jpeg_round_trip(const ImageF& linear, int quality) {
  const std::string file = encode_jpeg(linear, quality);
  const TurboJpeg decompressor(tjInitDecompress());
  if (!decompressor) throw Failure("libjpeg-turbo", "could not start", "check the free memory");
  std::vector<std::uint8_t> bytes(linear.data.size());
  check(tjDecompress2(decompressor.get(), reinterpret_cast<const unsigned char*>(file.data()), file.size(),
                      bytes.data(), linear.width, 0, linear.height, TJPF_RGB, TJFLAG_ACCURATEDCT),
        decompressor);
  return linear_image(bytes, linear.width, linear.height);
}

std::unique_ptr<Detector> behind_jpeg(std::unique_ptr<Detector> inner, int quality) {
  return std::make_unique<JpegDetector>(std::move(inner), quality);
}

}  // namespace mirage
