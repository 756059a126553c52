#include "simulation/check_inputs.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <tuple>

#include "base/error.h"
#include "base/logging.h"
#include "base/sizes.h"
#include "geometry/mesh.h"
#include "sensors/raster/setup.h"

namespace mirage {
namespace {

constexpr const char* kNotFinite = "not finite";

bool is_finite(const BevBox& b) {
  return std::isfinite(b.x) && std::isfinite(b.y) && std::isfinite(b.length) && std::isfinite(b.width) &&
         std::isfinite(b.yaw);
}

bool is_finite(const Box3& box) {
  return is_finite(box.bev) && std::isfinite(box.bottom) && std::isfinite(box.height);
}

void check_camera(const PinholeCamera& camera, const std::string& where) {
  const auto positive = [](double value) { return std::isfinite(value) && value > 0; };
  if (!positive(camera.fx) || !positive(camera.fy))
    throw InputError(where, "camera fx, fy", "not positive numbers", "correct the calibration");
  if (!std::isfinite(camera.cx) || !std::isfinite(camera.cy))
    throw InputError(where, "camera cx, cy", kNotFinite, "correct the calibration");
  if (camera.width < 1 || camera.height < 1)
    throw InputError(where, "camera width, height", "not positive", "correct the calibration");
}

/// Iterator to the first number that is not finite.
auto first_bad(const std::vector<float>& values) {
  return std::ranges::find_if_not(values, [](float value) { return std::isfinite(value); });
}

void check_image(const ImageF& image, const PinholeCamera& camera, const std::string& where) {
  if (image.width != camera.width || image.height != camera.height || image.channels != 3)
    throw InputError(where, "image",
                     fmt::format("is {}×{}×{}, the calibration says {}×{}×3", image.width, image.height,
                                 image.channels, camera.width, camera.height),
                     "give the photograph that belongs to the calibration");
  const auto bad = first_bad(image.data);
  if (bad == image.data.end()) return;
  const auto pixel = (bad - image.data.begin()) / 3;
  throw InputError(where, fmt::format("image pixel ({}, {})", pixel % image.width, pixel / image.width),
                   kNotFinite, "repair the photograph");
}

std::string in_metres(const Vec3d& size) {
  return fmt::format("{:.4g} × {:.4g} × {:.4g} m", size.x(), size.y(), size.z());
}

/// Advice for a mesh whose longest extent is `longest`: the units in which that would be 0.2 to 5 m.
std::string unit_fix(double longest) {
  std::string units;
  for (const auto& [unit, scale] :
       {std::pair{"millimetres", 0.001}, std::pair{"centimetres", 0.01}, std::pair{"inches", 0.0254},
        std::pair{"metres taken for centimetres", 100.0}, std::pair{"metres taken for millimetres", 1000.0}})
    if (longest * scale >= 0.2 && longest * scale <= 5)
      units += fmt::format("{}{}? scale by {:g}", units.empty() ? "are these " : ", or ", unit, scale);
  return units.empty() ? "give one object, in metres" : units + "; a whole scene is not an object";
}

}  // namespace

void check_frame(const Frame& frame) {
  const std::string where = frame.id.empty() ? "frame" : "frame " + frame.id;
  const Calibration& calibration = frame.calibration;
  check_camera(calibration.camera, where);
  if (!calibration.camera_from_velo.matrix().allFinite() ||
      !calibration.camera_from_rect.matrix().allFinite() || !calibration.rect_from_cam0.allFinite())
    throw InputError(where, "calibration", "a transform is not finite", "correct the calibration");
  check_image(frame.image, calibration.camera, where);
  for (std::size_t i = 0; i < frame.sweep.size(); ++i) {
    const LidarPoint& p = frame.sweep[i];
    if (!p.position().allFinite() || !std::isfinite(p.reflectance))
      throw InputError(where, fmt::format("sweep point {}", i), kNotFinite, "remove the point");
  }
  for (const Measurement& measured : frame.measurements) {
    const auto bad = first_bad(measured.data);
    if (bad != measured.data.end())
      throw InputError(where, fmt::format("{} value {}", measured.name, bad - measured.data.begin()),
                       kNotFinite, "repair the measurement");
  }
  for (std::size_t i = 0; i < frame.labels.size(); ++i)
    if (has_box(frame.labels[i]) && !is_finite(frame.labels[i].box))
      throw InputError(where, fmt::format("label {}", i), "its box is not finite", "correct the label");
  const Lighting& light = frame.lighting;
  if (!light.to_sun_velo.allFinite() || !light.sun.allFinite() || !light.ambient.allFinite() ||
      !light.hemisphere.allFinite())
    throw InputError(where, "lighting", kNotFinite, "correct the lighting");
}

void check_lidar(const LidarModel& lidar) {
  const std::string where = lidar.name.empty() ? "LiDAR model" : "LiDAR model " + lidar.name;
  if (lidar.beams.empty()) throw InputError(where, "beams", "there are none", "give at least one beam");
  for (std::size_t i = 0; i < lidar.beams.size(); ++i) {
    const LidarBeam& beam = lidar.beams[i];
    if (!std::isfinite(beam.elevation) || !std::isfinite(beam.height) || !std::isfinite(beam.lateral) ||
        !std::isfinite(beam.azimuth_offset))
      throw InputError(where, fmt::format("beam {}", i), kNotFinite, "correct the table of beams");
  }
  if (!std::isfinite(lidar.azimuth_step) || !std::isfinite(lidar.encoder_step) ||
      !std::isfinite(lidar.azimuth_min) || !std::isfinite(lidar.azimuth_max))
    throw InputError(where, "azimuths", kNotFinite, "correct the model");
  if (std::isnan(lidar.range_min) || std::isnan(lidar.range_max))
    throw InputError(where, "range limits", "not numbers", "correct the model");
  if (!lidar.velo_from_lidar.matrix().allFinite())
    throw InputError(where, "mount pose", kNotFinite, "correct the model");
}

void check_placement(const Placement& placement) {
  if (placement.carrier && !is_finite(placement.carrier->label.box))
    throw InputError("host label", placement.carrier->label.type, "its box is not finite",
                     "correct the label");
  if (!placement.velo_from_adversary.matrix().allFinite())
    throw InputError("placement", "velo_from_adversary", kNotFinite, "give a pose");
}

void check_textured(const TexturedMesh& object, const std::string& where) {
  check_mesh(object, where);
  if (object.mesh.faces.empty() || object.atlas.texels.empty())
    throw InputError(where, "mesh", "has no faces or no texels", "give a textured mesh");
}

void check_object(const TexturedMesh& object, const std::string& where) {
  check_textured(object, where);
  const Eigen::AlignedBox3d box = bounds(object.mesh);
  const double longest = box.sizes().maxCoeff();
  if (!(longest >= kMinObject && longest <= kMaxObject))
    throw InputError(where, "size",
                     fmt::format("{} is not an object for a car's roof ({:g} to {:g} m)",
                                 in_metres(box.sizes()), kMinObject, kMaxObject),
                     unit_fix(longest));
  constexpr double kMaxOffset = 2;  // m
  const Vec2d outside = box.min().head<2>().cwiseMax(-box.max().head<2>()).cwiseMax(0.0);
  if (outside.norm() > kMaxOffset)
    throw InputError(where, "place",
                     fmt::format("lies {:.3g} m beside its origin, which is set on the roof", outside.norm()),
                     "move the mesh to its origin");
}

void warn_of_large_object(const Vec3d& size, const std::string& where) {
  constexpr double kOfARoof = 3;  // m; roofs are about 2 × 1.3 m, their loads are longer
  if (size.maxCoeff() > kOfARoof)
    spdlog::warn(
        "{}: {} is larger than a car's roof, about 2 × 1.3 m: it hides what no load would; keep every side "
        "within {:g} m (--size {:g})",
        where, in_metres(size), kOfARoof, kOfARoof / 2);
}

void check_window(const PreparedFrame& prepared, std::size_t of, const PixelRect& rect) {
  const ImageF &image = prepared.frame.image_of(of), &depth = prepared.depth_of(of);
  const PinholeCamera& camera = prepared.frame.calibration_of(of).camera;
  const std::string where = "prepared frame", fix = "prepare the frame again";
  for (const auto& [name, picture, channels] :
       {std::tuple{"image", &image, 3}, std::tuple{"depth", &depth, 1}}) {
    if (picture->width != camera.width || picture->height != camera.height || picture->channels != channels)
      throw InputError(where, name, "is not of the calibration's size", fix);
    for (int v = rect.v0; v < rect.v1; ++v)
      for (int u = rect.u0; u < rect.u1; ++u)
        for (int c = 0; c < channels; ++c) {
          const float value = picture->at(u, v, c);
          if (std::isnan(value) || (channels == 3 && std::isinf(value)))
            throw InputError(where, fmt::format("{} pixel ({}, {})", name, u, v), kNotFinite, fix);
        }
  }
}

void check_settings(const SimulationSettings& settings) {
  SoftRasterSettings<double> raster = settings.raster;
  raster.near = 1;
  raster.far = 2;
  raster::check_settings(raster);
  const auto demand = [](bool good, const char* field, const char* problem, const char* fix) {
    if (!good) throw InputError("simulation settings", field, problem, fix);
  };
  demand(settings.supersampling >= 1 && settings.supersampling <= raster::kTile, "supersampling",
         "out of range", "use 1 to 32");
  demand(std::isfinite(settings.lidar_reflectivity) && settings.lidar_reflectivity >= 0, "lidar_reflectivity",
         "not a number from 0", "use a share in [0, 1]");
  demand(std::isfinite(settings.occlusion_margin), "occlusion_margin", kNotFinite, "use metres, e.g. 0.3");
  demand(settings.grazing_cosine > 0 && settings.grazing_cosine <= 1, "grazing_cosine", "not in (0, 1]",
         "use e.g. 0.05");
  try {
    check_fields(settings.camera_effects);
  } catch (const FieldError& problem) {
    throw InputError("simulation settings", "camera_effects", problem.what(), "use ideal or unit");
  }
}

void check_upstream(const Simulated& simulated, const Upstream& upstream) {
  const std::string where = "upstream gradient", fix = "check the detector and the loss that it comes from";
  const auto check_pixels = [&](const std::string& name, const CameraSight& sight,
                                const GradientView& d_image) {
    const PixelRect& rect = sight.rect;
    for (int v = rect.v0; v < rect.v1; ++v)
      for (int u = rect.u0; u < rect.u1; ++u)
        for (std::size_t c = 0; c < 3; ++c)
          if (!std::isfinite(d_image[3 * (as_size(v) * as_size(sight.image.width) + as_size(u)) + c]))
            throw Failure(where, fmt::format("{} pixel ({}, {}) is {}", name, u, v, kNotFinite), fix);
  };
  if (upstream.image) {
    if (upstream.width != simulated.image.width || upstream.height != simulated.image.height)
      throw InputError(where, "d_image", "is not of the image's size", "give height × width × 3 values");
    check_pixels("d_image", simulated, upstream.image);
  }
  const std::size_t cameras = simulated.others.size(), measurements = simulated.measurements.size();
  if (!upstream.others.empty() && upstream.others.size() != cameras + measurements)
    throw InputError(where, "others",
                     "does not have one entry for each of the other cameras and measurements",
                     "give null for those without a gradient");
  for (std::size_t k = 0; k < upstream.others.size(); ++k) {
    const GradientView& gradient = upstream.others[k];
    if (!gradient) continue;
    if (k < cameras) {
      check_pixels(fmt::format("d_image of other camera {}", k), simulated.others[k], gradient);
      continue;
    }
    const Measurement& measured = simulated.measurements[k - cameras];
    for (std::size_t i = 0; i < measured.data.size(); ++i)
      if (!std::isfinite(gradient[i]))
        throw Failure(where, fmt::format("{} value {} is {}", measured.name, i, kNotFinite), fix);
  }
  const GradientView& presence = upstream.presence;
  if (presence.size() > 0 && (!upstream.silhouette || upstream.silhouette->places.size() != presence.size()))
    throw InputError(where, "presence", "does not have one entry a place of the silhouette",
                     "give a number for every place");
  for (std::size_t i = 0; i < presence.size(); ++i)
    if (!std::isfinite(presence[i]))
      throw Failure(where, fmt::format("presence of place {} is {}", i, kNotFinite), fix);
  const GradientView& d_points = upstream.points;
  if (d_points.size() == 0) return;
  if (d_points.size() != simulated.sweep.size())
    throw InputError(where, "d_points", "does not have one entry a point of the simulated sweep",
                     "give a gradient for every point");
  const std::size_t first = d_points.size() - as_size(simulated.adversary_points);
  for (std::size_t i = 4 * first; i < 4 * d_points.size(); ++i)
    if (!std::isfinite(d_points[i]))
      throw Failure(where, fmt::format("d_points point {} is {}", i / 4, kNotFinite), fix);
}

}  // namespace mirage
