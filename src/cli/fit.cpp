// mirage fit: fits the shape manifold to the vehicles of a data set, or learns the manifold.
#include "generator/fit.h"

#include <fmt/format.h>

#include <cmath>
#include <cstdio>

#include "base/disk_cache.h"
#include "base/error.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/parallel.h"
#include "base/provenance.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "detection/detect.h"
#include "exchange/mesh_files.h"
#include "frames/data_check.h"
#include "frames/frame_cache.h"
#include "generator/car_body.h"
#include "scene/data/data_rig.h"
#include "scene/data/data_set.h"
#include "scene/data/read_frames.h"

namespace mirage::cli {
namespace {

constexpr std::size_t kMaxVehicles = 100'000;  // of a frame
constexpr double kMaxLabelNoise = 10;          // beyond 13 times a drawn size could be negative

struct FitOptions {
  std::filesystem::path data, model, build_model, meshes;
  std::string rig, forward, up, format = "ply";
  int frames = 0, each = 80, dimension = 16, min_points = kMinFitReturns;
  FitFrameSettings frame;
};

nlohmann::json build_model(const FitOptions& options, const Common& common) {
  std::vector<ShapeSample> samples = family_samples(options.each, common.seed);
  if (!options.meshes.empty()) {
    std::optional<MeshAxes> axes;
    if (options.forward.empty() != options.up.empty())
      throw InputError("--mesh-forward, --mesh-up", "", "one of them is missing", "give both or neither");
    if (!options.forward.empty()) axes = MeshAxes{options.forward, options.up};
    for (ShapeSample& sample : read_vehicle_meshes(options.meshes, axes))
      samples.push_back(std::move(sample));
  }
  ShapeModelSettings settings;
  settings.dimension = options.dimension;
  Progress progress("shape model", samples.size(), common.quiet);
  const ShapeModel model = build_shape_model(samples, settings, [&] { progress.add(); });
  write_shape_model(options.build_model, model);
  print_table({{"vehicles", fmt::format("{}", model.vehicles)},
               {"dimensions", fmt::format("{}", model.dimension)},
               {"variance explained", percent(model.explained.back())},
               {"grid", fmt::format("{} × {} × {}", model.layout.count[0], model.layout.count[1],
                                    model.layout.count[2])},
               {"model", options.build_model.string()}});
  return {{"vehicles", model.vehicles},
          {"dimension", model.dimension},
          {"explained", model.explained},
          {"sources", model.sources},
          {"model", options.build_model.string()}};
}

std::string centimetres(const FitSpread& spread) {
  return fmt::format("{:5.1f} {:6.1f}", 100 * spread.median, 100 * spread.p95);
}

void print_row(const std::string& name, const FitSummary& fits) {
  fmt::print("{:<10} {:>8} {:>7} {:>9} {:>8}", name, fits.vehicles, fits.fitted,
             fits.fitted ? fmt::format("{:.1f} mm", 1000 * fits.residual.median) : "-",
             fits.fitted ? fmt::format("{:.1f}", 1000 * fits.seconds.median) : "-");
  if (fits.error)
    fmt::print("{:37}{:<14}{:<14}{:<14}", "", centimetres(fits.error->roof[0]),
               centimetres(fits.error->roof[1]), centimetres(fits.error->roof[2]));
  fmt::print("\n");
}

void print_report(const FitReport& report) {
  fmt::print("{:<10} {:>8} {:>7} {:>9} {:>8}", "range", "vehicles", "fitted", "residual", "ms");
  if (report.all.error) fmt::print("   roof error (cm, median and 95 %): {:<14}{:<14}{:<14}", "x", "y", "z");
  fmt::print("\n");
  for (const FitClass& c : report.by_range)
    print_row(std::isfinite(c.high) ? fmt::format("{:.0f}–{:.0f} m", c.low, c.high)
                                    : fmt::format("{:.0f}+ m", c.low),
              c.fits);
  print_row("all", report.all);
  std::fflush(stdout);
}

/// Fits the frames one by one and stores each result in OUT/frames at once.
struct FitWork {
  const FitOptions& options;
  const std::filesystem::path& out;
  const ShapeRoofFinder& finder;
  const LidarModel& lidar;
  const FitFrameSettings& settings;
  const std::optional<generator::StreetSource>& source;
  Provenance provenance;  ///< without the frame

  std::filesystem::path file_of(const std::string& id) const {
    return out / "frames" / (escape_name(id) + ".json");
  }
  std::filesystem::path mesh_of(const std::string& id, int label) const {
    return out / "meshes" / fmt::format("{}_{}.{}", escape_name(id), label, options.format);
  }

  /// The list of to_json(vehicle) for the frame's vehicles, stored or computed.
  nlohmann::json fit(const std::string& id) const {
    Provenance of_frame = provenance;
    of_frame.input("frame", open_data_set(options.data)->hash(id));
    of_frame.set("mesh_format", options.format);
    const std::string key = of_frame.identity();
    if (auto stored = stored_fits(id, key)) return std::move(*stored);
    const Frame frame = read_frame(options.data, id);
    std::vector<generator::TrueVehicle> truth;
    const auto index = source ? try_parse_number<std::uint64_t>(id) : std::nullopt;
    if (index) truth = generator::true_vehicles(*source, *index, lidar.height);
    const std::vector<FittedVehicle> fits =
        fit_frame(finder, frame, lidar, settings, index ? &truth : nullptr);
    if (options.format != "none")
      for (const FittedVehicle& v : fits) {
        std::filesystem::remove(mesh_of(v.frame, v.label));  // of other settings
        if (v.fit.fitted) write_mesh(mesh_of(v.frame, v.label), v.fit.mesh);
      }
    nlohmann::json rows = list_json(fits);
    write_json(file_of(id), {{"key", key}, {"vehicles", rows}});
    return rows;
  }

 private:
  /// Empty as read_cached, and if a mesh is missing.
  std::optional<nlohmann::json> stored_fits(const std::string& id, const std::string& key) const {
    return read_cached(file_of(id), key, [&](const JsonFields& fields) -> std::optional<nlohmann::json> {
      const nlohmann::json& rows = fields.list("vehicles", kMaxVehicles);
      for (const nlohmann::json& row : rows) {
        const FittedVehicle v = read_fitted_vehicle(fields.inner("vehicles", row));
        if (options.format != "none" && v.fit.fitted && !std::filesystem::exists(mesh_of(v.frame, v.label)))
          return std::nullopt;
      }
      return rows;
    });
  }
};

Provenance made_of_fit(const FitOptions& options, const std::filesystem::path& model, const LidarModel& lidar,
                       const FitFrameSettings& settings,
                       const std::optional<generator::StreetSource>& source) {
  Provenance provenance;
  provenance.file("model", model);
  provenance.input("lidar", lidar_identity(lidar));
  provenance.set("min_points", options.min_points);
  provenance.set("types", settings.types);
  provenance.set("label_noise", settings.label_noise);
  provenance.set("seed", settings.seed);
  if (source) provenance.set("street", {source->seed, name_of(source->look), source->behind});
  return provenance;
}

nlohmann::json fit_data_set(const FitOptions& options, const Common& common) {
  const auto model_file = options.model.empty() ? shipped_file("scenes/shapes/cars.shape") : options.model;
  const LidarModel lidar = lidar_of(options.data, options.rig);
  check_data(options.data, options.rig, UnitUse::casts_rays);
  const ShapeRoofFinder finder(read_shape_model(model_file), lidar, options.min_points);
  const std::vector<std::string> ids = list_frames(options.data, as_size(options.frames));
  const auto source = generator::source_of(options.data);
  FitFrameSettings frame_settings = options.frame;
  for (std::string& type : frame_settings.types) type = kitti_type(type);
  const LabelCensus census = count_labels(options.data, ids);
  require_types(census, frame_settings.types, "--types");
  if (rank() == 0) warn_of_labels(census);
  frame_settings.seed = common.seed;

  const FitWork work{options,
                     common.out,
                     finder,
                     lidar,
                     frame_settings,
                     source,
                     made_of_fit(options, model_file, lidar, frame_settings, source)};
  std::vector<nlohmann::json> fits(ids.size());
  Progress progress("fit", ids.size(), common.quiet);
  const std::vector<std::size_t> order = order_among_ranks(ids.size());
  parallel_for(ids.size(), [&](std::size_t k) {
    if (interrupted()) return;
    fits[order[k]] = work.fit(ids[order[k]]);
    progress.add();
  });
  throw_if_interrupted("run the same command again to resume");
  if (rank() > 0) return nlohmann::json::object();  // the first tells
  std::vector<FittedVehicle> all;
  nlohmann::json rows = nlohmann::json::array();
  for (std::size_t i = 0; i < ids.size(); ++i)
    for (nlohmann::json& row : fits[i]) {
      all.push_back(read_fitted_vehicle({work.file_of(ids[i]), row, kKeptAgain}));
      rows.push_back(std::move(row));
    }
  write_json(common.out / "vehicles.json", {{"vehicles", std::move(rows)}});
  const FitReport report = summarise_fits(all);
  print_report(report);
  nlohmann::json summary = to_json(report);
  summary.update({{"frames", ids.size()},
                  {"vehicles", report.all.vehicles},
                  {"fitted", report.all.fitted},
                  {"from_box", report.all.vehicles - report.all.fitted},
                  {"model", model_file.string()},
                  {"truth_known", report.all.error.has_value()},
                  {"label_noise", frame_settings.label_noise}});
  return summary;
}

void add_options(CLI::App& app, FitOptions& options) {
  auto* data =
      app.add_option("--data", options.data, "data set (KITTI's object, tracking or raw layout, nuScenes)");
  app.add_option("--rig", options.rig, kRigHelp);
  auto* build =
      app.add_option("--build-model", options.build_model, "learn a shape model and write it here (*.shape)");
  data->excludes(build);
  app.add_option("--model", options.model, "shape model (default: the shipped one)");
  add_defaulted(app, "--frames", options.frames, "only the first N frames (0: all)")
      ->check(within(kNotNegative));
  add_defaulted(app, "--types", options.frame.types, "labels to fit: Car, Van");
  add_defaulted(app, "--label-noise", options.frame.label_noise,
                "first add noise to the labels; standard deviations are this times 7 cm (x, y), 5 cm (z), "
                "0.02 rad (yaw), 3 % (size)")
      ->check(within({0, kMaxLabelNoise}));
  add_defaulted(app, "--min-points", options.min_points, "vehicles with fewer returns use their labelled box")
      ->check(within(kFromOne));
  add_defaulted(app, "--mesh-format", options.format, "meshes written: ply, glb or none")
      ->check(one_of({"ply", "glb", "none"}));
  add_defaulted(app, "--each", options.each, "with --build-model: cars of each of the seven body styles")
      ->check(within({0, 10000}));
  add_defaulted(app, "--dimension", options.dimension, "with --build-model: components")
      ->check(within({1, 200}));
  app.add_option("--meshes", options.meshes,
                 "with --build-model: folder of your own vehicles (glb, gltf, obj, ply)")
      ->needs(build);
  app.add_option("--mesh-forward", options.forward,
                 "with --meshes: axis of its files that points forward, e.g. -z");
  app.add_option("--mesh-up", options.up, "with --meshes: axis of its files that points up, e.g. +y");
}

nlohmann::json run(const FitOptions& options, const Common& common) {
  if (!options.build_model.empty()) {
    if (rank_count() > 1)
      throw InputError("--build-model", "mpirun", "a model is learned in one process",
                       "start it without mpirun");
    return build_model(options, common);
  }
  if (options.data.empty())
    throw InputError("mirage fit", "--data", "missing", "give a data set, or --build-model FILE");
  return fit_data_set(options, common);
}

}  // namespace

Command fit_command() {
  return command_of<FitOptions>({
      .name = "fit",
      .help = "fits the vehicle shape manifold: meshes, rooftops, fitting error",
      .example = "mirage fit --data generated --mesh-format glb",
      .many_ranks = true,
  });
}

}  // namespace mirage::cli
