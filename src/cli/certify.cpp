// mirage certify: cars that no object on their roof can hide.
#include <cmath>
#include <set>

#include "attack/zoo.h"
#include "base/error.h"
#include "base/names.h"
#include "base/ranks.h"
#include "cli/command.h"
#include "cli/options.h"
#include "defense/certificate.h"
#include "detection/detect.h"
#include "frames/frame_provenance.h"
#include "scene/data/read_frames.h"

namespace mirage::cli {
namespace {

struct CertifyOptions : FrameSource {
  std::filesystem::path run;
  std::vector<std::filesystem::path> meshes;
  TrustRun trust = TrustRun::no;
  DetectorOptions detector;
  CertificateSettings settings;
  LidarEffectsOption effects{"ideal"};
  double min_view = 0.7;
  std::size_t frames = 0;
};

/// "55.6 % (46.2–66.7)", or with another end "55.6–77.8 % (46.2–85.1)"
std::string bracket(const Interval& certified, const Interval* attacked) {
  if (attacked == nullptr) return percent(certified);
  return fmt::format("{:.1f}–{} ({:.1f}–{:.1f})", 100 * certified.value, percent(attacked->value),
                     100 * certified.low, 100 * attacked->high);
}

void print_shares(const CertificateResult& result, const CertificateSettings& settings) {
  const auto cell = [](const CertifiedBand& band, const Bracket& of, bool attacked) {
    return band.hosts > 0 ? bracket(of.certified, attacked ? &of.attacked : nullptr) : std::string("no cars");
  };
  const auto both = [](const Interval& at70, const Interval& at50) {
    return percent(at70) + " | " + percent(at50);
  };
  const CertifiedShares& any = result.shares.front();
  Rows rows = {{"cars", std::to_string(result.hosts.size())},
               {"found as recorded, IoU 0.7 | 0.5 (95 %)", both(any.clean70, any.clean50)},
               {"control: under a mask over the car itself", both(any.control70, any.control50)}};
  for (const CertifiedShares& of : result.shares) {
    if (of.adversaries > 0)
      rows.push_back({fmt::format("L = {:g} m, found under {} known object{}, without masks", of.size,
                                  of.adversaries, of.adversaries > 1 ? "s" : ""),
                      both(of.attacked70, of.attacked50)});
    if (of.objects > 0)
      rows.push_back({fmt::format("L = {:g} m, objects that reach past the mask", of.size),
                      fmt::format("{} of {}", of.violations, of.objects)});
  }
  for (std::size_t s = 0; s < result.lattice_ap70.size(); ++s)
    rows.push_back(
        {fmt::format("L = {:g} m, AP 0.7 of the whole lattice of {} masks", settings.sizes[s],
                     result.masks[s]),
         fmt::format("{}, plain {}", percent(result.lattice_ap70[s]), percent(result.clean_ap70))});
  rows.push_back({"intervals over", to_string(result.clusters)});
  print_table(rows);
  Columns table = {{"certified–found under known objects, IoU 0.5"}};
  for (const CertifiedBand& band : any.bands)
    table.front().push_back(
        std::isfinite(band.farthest) ? fmt::format("{:g}–{:g} m", band.nearest, band.farthest) : "all");
  for (const CertifiedShares& of : result.shares) {
    table.push_back({fmt::format("L = {:g} m, roof known", of.size)});
    for (const CertifiedBand& band : of.bands) table.back().push_back(cell(band, band.known50, true));
    if (!settings.with_lattice) continue;
    table.push_back({fmt::format("L = {:g} m, lattice", of.size)});
    for (const CertifiedBand& band : of.bands)
      table.back().push_back(cell(band, band.lattice50, settings.whole_lattice));
  }
  print_columns(table);
}

void add_options(CLI::App& app, CertifyOptions& options) {
  CertificateSettings& settings = options.settings;
  add_fields(app, static_cast<FrameSource&>(options), {"placement", "cameras"});  // it is about roofs
  app.add_option("--run", options.run, "run folder whose adversary is also judged");
  app.add_option("--mesh", options.meshes, "objects that are also judged (.glb, .obj, .ply), or zoo");
  add_trust_option(app, options.trust);
  add_fields(app, options.detector);
  add_defaulted(app, "--frames", options.frames, "only the first N frames; 0: all");
  add_min_view_option(app, options.min_view);
  add_defaulted(app, "--sizes", settings.sizes, "half lengths L of the box, m (height 5/4 L), with commas")
      ->delimiter(',');
  add_fields(app, settings);
  add_score_option(app, settings.evaluation.score_threshold);
  options.effects.add(app);
  add_cache_note(app);
}

nlohmann::json run(const CertifyOptions& options, const Common& common) {
  CertificateSettings settings = options.settings;
  settings.seed = common.seed;
  settings.evaluation.quiet = common.quiet;
  const std::vector<NamedObject> objects = read_objects(options.meshes);
  for (const NamedObject& object : objects) settings.adversaries.push_back(object.mesh);
  if (!options.run.empty()) {
    Run run = read_run(options.run, options.trust);
    if (const PlaceChoice& place = run.settings.placement; content_of(place) != content_of(options.placement))
      throw FieldError(
          "run", options.run.string(),
          fmt::format("was learned at the place {}, and a certificate is about roofs", text_of(place)),
          "give a run that was learned on roofs");
    settings.adversaries.push_back(std::move(run.adversary));
  }
  std::set<double> sizes;
  for (const double size : settings.sizes)
    if (!sizes.insert(size).second)
      throw FieldError("sizes", fmt::format("{:g}", size), "is given twice", "give each size once");
  if (settings.whole_lattice && !settings.with_lattice)
    throw InputError("--whole-lattice", "", "is of the lattice", "add --lattice");
  const LidarModel lidar = lidar_of(options.data, options.rig);
  options.effects.apply(settings.simulation, lidar, recorded_lidar_effects(options.data, options.rig),
                        common.seed);
  FrameStore store(options);
  const DetectorOptions detector_options = with_common(options.detector, common, options);
  if (detector_options.locality > 0)
    throw InputError("--locality", fmt::format("{}", detector_options.locality),
                     "is an approximation, and proves nothing", "leave it out");
  const std::vector<std::string> frames = list_frames(options.data, options.frames);
  check_labels(options.data, frames, "a certificate", options.classes, options.cameras);
  const DetectorPool detectors = load_detector_pool(detector_options, static_cast<int>(frames.size()));
  settings.evaluation.detector_identity =
      detector_identity(detector_options, detectors.front()->capabilities().version);
  require_shared(store.cache(), "certify", settings.evaluation.detector_identity);
  const std::vector<HostId> hosts = host_ids(find_all_hosts(
      store, frames, detectors.front()->region(), settings.simulation, options.min_view, common.quiet));
  if (hosts.empty())
    throw InputError(options.data.string(), "labels", "no car has the adversary in view",
                     "give more frames or lower --min-view");
  const CertificateResult result = certify(detectors, store, hosts, lidar, settings);
  if (rank() > 0) return nlohmann::json::object();  // the first tells
  common.provenance->add(settings.simulation);
  add_frames(*common.provenance, options, frames);
  add_detector(*common.provenance, detector_options);
  add_objects(*common.provenance, objects);
  print_shares(result, settings);
  nlohmann::json json = to_json(result, settings);
  json["data"] = options.data.string();
  json["depth"] = escape_name(options.depth);
  json["rooftop"] = escape_name(options.rooftop);
  json["sun"] = options.sun;
  json["detector"] = detector_options.detector;
  json["weights"] = detector_options.weights.string();
  json["defense"] = detector_options.defense;
  return json;
}

}  // namespace

Command certify_command() {
  return command_of<CertifyOptions>({
      .name = "certify",
      .help = "counts cars that no object within a box on their roof can hide",
      .example = "mirage certify --data generated --detector lidar",
      .many_ranks = true,
  });
}

}  // namespace mirage::cli
