#include "simulation/camera_pass.h"

#include "sensors/exact_coverage.h"

namespace mirage {
namespace {

/// A window wide enough for what lies beyond the picture's edges.
RasterTarget<float> wide_target(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                                const PinholeCamera& camera) {
  const PixelRect rect = touched_pixels(mesh, settings, camera.width, camera.height,
                                        {-camera.width, -camera.height, 2 * camera.width, 2 * camera.height});
  return window_of(camera, rect, ImageF(rect.width(), rect.height(), 3));
}

class FastPass : public CameraPass {
 public:
  Image<double> draw(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                     const RasterTarget<float>& target) override {
    const RasterJob job{&mesh, &settings, &target};
    rasterize_batch({&job, 1}, {&tape_, 1});
    return to_double(tape_.rgba);
  }

  ScreenGradient<double> vjp(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                             const RasterTarget<float>& target, const Image<double>& d_rgba) const override {
    const RasterJob job{&mesh, &settings, &target};
    const ImageF upstream = to_float(d_rgba);
    ScreenGradient<double> gradient;
    rasterize_batch_vjp({&job, 1}, {&upstream, 1}, {&tape_, 1}, {&gradient, 1});
    return gradient;
  }

  double unobstructed_area(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                           const PinholeCamera& camera) const override {
    return silhouette_area(FastPass().draw(mesh, settings, wide_target(mesh, settings, camera)));
  }

 private:
  mutable RasterTape tape_;  // its VJP needs working memory
};

class ReferencePass : public CameraPass {
 public:
  Image<double> draw(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                     const RasterTarget<float>& target) override {
    return rasterize(mesh, settings, to_double(target));
  }

  ScreenGradient<double> vjp(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                             const RasterTarget<float>& target, const Image<double>& d_rgba) const override {
    return rasterize_vjp(mesh, settings, to_double(target), d_rgba);
  }

  double unobstructed_area(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>& settings,
                           const PinholeCamera& camera) const override {
    return silhouette_area(rasterize(mesh, settings, to_double(wide_target(mesh, settings, camera))));
  }
};

class ExactPass : public CameraPass {
 public:
  Image<double> draw(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>&,
                     const RasterTarget<float>& target) override {
    draw_exact(mesh, target, tape_);
    return tape_.rgba;
  }

  ScreenGradient<double> vjp(const ScreenMesh<double>& mesh, const SoftRasterSettings<double>&,
                             const RasterTarget<float>& target, const Image<double>& d_rgba) const override {
    return draw_exact_vjp(mesh, target, d_rgba, tape_);
  }

  double unobstructed_area(const ScreenMesh<double>&, const SoftRasterSettings<double>&,
                           const PinholeCamera&) const override {
    return tape_.area;
  }

 private:
  ExactTape tape_;
};

}  // namespace

double silhouette_area(const Image<double>& rgba) {
  double area = 0;
  for (std::size_t i = 3; i < rgba.data.size(); i += 4) area += rgba.data[i];
  return area;
}

RasterTarget<float> window_of(const PinholeCamera& camera, const PixelRect& rect, ImageF background,
                              int supersampling) {
  return {camera.width, camera.height, rect, supersampling, std::move(background), {}};
}

std::unique_ptr<CameraPass> camera_pass(const SimulationSettings& settings) {
  if (settings.exact_coverage) return std::make_unique<ExactPass>();
  if (settings.reference) return std::make_unique<ReferencePass>();
  return std::make_unique<FastPass>();
}

}  // namespace mirage
