#include "validation/view/drive_view.h"

#include <fmt/format.h>

#include <algorithm>

#include "attack/evaluate_run.h"
#include "attack/evaluation.h"
#include "attack/zoo.h"
#include "base/child_process.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/sizes.h"
#include "detection/car_in_picture.h"
#include "detection/defenses.h"
#include "frames/frame_provenance.h"
#include "scene/data/read_frames.h"
#include "scene/depth/learned_depth.h"
#include "simulation/insertion.h"
#include "simulation/sensor_plugin.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr const char* kAgain = "run the same mirage drive again into an empty folder";
constexpr std::size_t kMaxRows = 100000, kNamed = 12;
constexpr int kFrameQuality = 92;

/// The names of a drive's vehicles, those first whose gaps the object prolongs most.
std::vector<std::string> names_by_gap(const JsonFields& drive) {
  std::vector<VehicleDrive> vehicles;
  for (const json& entry : drive.list("vehicles", kMaxRows))
    vehicles.push_back(read_vehicle_drive(drive.inner(fmt::format("vehicles[{}]", vehicles.size()), entry)));
  std::vector<std::string> names;
  for (const VehicleDrive* vehicle : by_added_gap(vehicles))
    names.push_back(vehicle_name(vehicle->sequence, vehicle->track));
  return names;
}

void require_vehicle(const std::string& name, const std::vector<std::string>& known) {
  if (std::find(known.begin(), known.end(), name) != known.end()) return;
  std::vector<std::string> offered = closest_words(name, known);
  if (offered.empty()) offered = known;
  if (offered.size() > kNamed) offered.resize(kNamed);
  throw InputError("--vehicle", name, "is not a vehicle of that drive", use_one_of(name, offered));
}

/// Each frame's rows of `width` numbers, as DriveRequest::folder says.
std::vector<std::vector<std::vector<double>>> rows_of(const JsonFields& shown, const std::string& key,
                                                      std::size_t frames, std::size_t width) {
  std::vector<std::vector<std::vector<double>>> rows;
  try {
    rows = shown.list(key, frames).get<decltype(rows)>();
  } catch (const json::exception&) {
    shown.fail(key, "is not a list of rows of numbers for each frame");
  }
  if (rows.size() != frames) shown.fail(key, fmt::format("has {} frames of {}", rows.size(), frames));
  for (const auto& frame : rows)
    for (const auto& row : frame)
      if (row.size() != width)
        shown.fail(key, fmt::format("has a row of {} numbers, not {}", row.size(), width));
  return rows;
}

Box3 box_at(const double* row) {
  return {{row[0], row[1], row[3], row[4], row[6]}, row[2], row[5]};
}

std::vector<ViewDetections> shown_of(const JsonFields& vehicle, DriveVersion version, std::size_t frames) {
  if (!vehicle.has("shown")) vehicle.fail("shown", "is missing");
  const JsonFields shown = vehicle.object("shown").object(kDriveVersions[as_size(version)]);
  const auto boxes = rows_of(shown, "boxes", frames, 8), tracks = rows_of(shown, "tracks", frames, 9);
  std::vector<ViewDetections> all(frames);
  for (std::size_t i = 0; i < frames; ++i) {
    all[i].looked = true;
    for (const auto& row : boxes[i])
      all[i].found.push_back({.box = box_at(row.data()), .picture = {}, .score = row[7]});
    for (const auto& row : tracks[i])
      all[i].tracks.push_back({static_cast<int>(row[0]), box_at(row.data() + 1), row[8] > 0});
  }
  return all;
}

/// The overrides that the drive was given for its run's settings. A foreign folder may name code, which is
/// loaded only if the user trusts it.
Overrides overrides_of(const fs::path& file, const JsonFields& result, TrustRun trust) {
  const JsonFields stored = result.object("asked");
  Overrides overrides;
  for (const std::string& name : stored.names()) overrides[name] = stored.text(name);
  if (trust == TrustRun::yes) return overrides;
  const auto refuse = [&](const char* field) {
    throw InputError(file.string(), field, "would be loaded, which is code: " + overrides.at(field),
                     "if you trust it, add --trust-run");
  };
  if (overrides.contains("depth") && !is_shipped_depth(overrides.at("depth"))) refuse("depth");
  if (overrides.contains("sensors"))
    for (const std::string& word : listed_words(overrides.at("sensors")))
      if (!is_shipped_sensor(word)) refuse("sensors");
  return overrides;
}

/// The file or folder of the object.
fs::path object_file(const JsonFields& result, const DriveChoice& choice) {
  return choice.run.empty() ? fs::path(result.text("object")) : choice.run;
}

/// A run's adversary or a mesh.
Run object_of(const fs::path& file, const JsonFields& result, const DriveChoice& choice) {
  const fs::path object = object_file(result, choice);
  if (fs::is_directory(object)) return read_run(object, choice.trust);
  if (object.has_parent_path() && !fs::exists(object))
    throw InputError(file.string(), "object", fmt::format("\"{}\" is not there", object.string()),
                     "say where it is now: --run");
  return run_of_objects(read_objects({object}));
}

/// InputError if the object, the frames or their preparation differ in content from those that the drive
/// judged: its verdict holds only for those.
void require_same_inputs(const JsonFields& provenance, const Run& run, const fs::path& object,
                         const fs::path& drive) {
  const JsonFields inputs = provenance.object("inputs"), settings = provenance.object("settings");
  const auto require = [&](const std::string& name, const std::string& hash, const fs::path& where,
                           const char* what, const char* fix) {
    if (inputs.text(name) != hash)
      throw InputError(where.string(), name, fmt::format("{} that {} judged", what, drive.string()),
                       fmt::format("{}, or {}", fix, kAgain));
  };
  require("object", hash_of(run.adversary), object, "is not the object", "say where that is: --run");
  SequencePart part;
  read_fields(settings, part);
  std::vector<std::string> frames;
  for (const Sequence& sequence : read_sequences(run.settings.data, part))
    for (const SequenceFrame& frame : sequence.frames) frames.push_back(frame.id);
  Provenance here;
  add_frames(here, run.settings, frames);
  const json now = here.provenance().at("inputs");
  for (const auto& [name, hash] : now.items())
    require(name, hash, run.settings.data,
            name == "data" ? "are not the frames" : "is not what prepared the frames",
            "give the data set of the drive with --data");
}

}  // namespace

DriveView::DriveView(const DriveChoice& choice) {
  const fs::path file = choice.drive / "result.json";
  if (!fs::exists(file))
    throw InputError(choice.drive.string(), "result.json", "missing, so this is not a finished drive",
                     "give the --out folder of a finished mirage drive");
  const json whole = read_json(file);
  const JsonFields result(file, whole, kAgain), provenance = result.object("provenance");
  const std::vector<std::string> names = names_by_gap(result.object("drive"));
  if (names.empty()) result.fail("drive", "has no vehicles");
  name_ = choice.vehicle.empty() ? names.front() : choice.vehicle;
  require_vehicle(name_, names);
  detector_ = result.text("detector");
  score_threshold_ = result.number("score_threshold", 0, 1);

  const fs::path vehicle_file = choice.drive / "vehicles" / (name_ + ".json");
  const json stored = read_json(vehicle_file);
  const JsonFields vehicle(vehicle_file, stored, kAgain);
  vehicle_ = read_vehicle_drive(vehicle);
  if (vehicle_.frames.empty()) vehicle.fail("frames", "there are none");
  clean_ = shown_of(vehicle, DriveVersion::clean, vehicle_.frames.size());
  attacked_ = shown_of(vehicle, DriveVersion::attacked, vehicle_.frames.size());

  const Run learned = object_of(file, result, choice);  // on its own data set
  run_ = learned;
  object_ = fs::weakly_canonical(object_file(result, choice)).stem();
  Overrides overrides = overrides_of(file, result, choice.trust);
  overrides["data"] = choice.data.empty() ? provenance.text("data") : choice.data.string();
  override_settings(run_, overrides, provenance.counter("seed"), true);

  const SequencePart part = {.sequence = vehicle_.sequence,
                             .between = provenance.object("settings").truth("between")};
  const std::vector<Sequence> sequences = read_sequences(run_.settings.data, part);
  std::map<int, const SequenceFrame*> by_index;
  for (const SequenceFrame& frame : sequences.front().frames) by_index[frame.moment.index] = &frame;
  std::vector<std::pair<Moment, HostId>> on_vehicle;
  for (const DriveFrame& seen : vehicle_.frames) {
    const auto at = by_index.find(seen.index);
    const auto label = at == by_index.end() ? -1 : [&] {
      const auto labels = read_annotations(run_.settings.data, at->second->id).labels;
      const auto of = std::find_if(labels.begin(), labels.end(), [&](const Label& one) {
        return one.track == vehicle_.track && has_box(one);
      });
      return of == labels.end() ? -1 : static_cast<int>(of - labels.begin());
    }();
    if (label < 0)
      throw InputError(run_.settings.data.string(), vehicle_.sequence,
                       fmt::format("vehicle {} is not in frame {}", vehicle_.track, seen.index),
                       "give the data set of the drive with --data");
    const std::string& id = at->second->id;
    places_[id] = frames_.size();
    frames_.push_back(id);
    hosts_.push_back({id, label});
    on_vehicle.emplace_back(at->second->moment, hosts_.back());
  }
  if (provenance.has("inputs"))
    require_same_inputs(provenance, run_, object_file(result, choice), choice.drive);
  const std::set<std::string> learned_frames = frames_learned_on(learned, run_.settings.data);
  learned_on_ = !hosts_learned_on(learned, run_.settings, hosts_, learned_frames).empty();
  store_ = std::make_unique<FrameStore>(run_.settings);
  carriers_ = roof_track(*store_, on_vehicle).carriers;
}

void DriveView::add(ViewFrame& view) {
  const std::size_t k = places_.at(view.frame.id);
  const auto prepared = store_->get(view.frame.id);
  const Placement placement = placement_of(run_.settings.placement, carriers_[k], prepared->frame.labels);
  const Simulated simulated = simulate(*prepared, placement, run_.adversary, run_.settings.simulation);
  view.found = clean_[k];
  ViewAttack attack = attack_of(view, *prepared, hosts_[k], simulated);
  attack.found = attacked_[k];
  const auto& observations = vehicle_.frames[k].observations;
  const auto found = [&](DriveVersion version) { return observations[as_size(version)].found; };
  attack.outcome.update({{"learned_on", learned_on_},
                         {"detected", found(DriveVersion::clean)},
                         {"hidden", found(DriveVersion::clean) && !found(DriveVersion::attacked)}});
  view.attacks.push_back(std::move(attack));
}

DriveAnimation::DriveAnimation(fs::path file) : file_(std::move(file)), folder_(file_) {
  folder_ += ".frames";
  if (file_.extension() != ".webp" && file_.extension() != ".gif")
    throw InputError("--animation", file_.string(), "is neither .webp nor .gif", "name one");
}

DriveAnimation::~DriveAnimation() {
  std::error_code none;
  fs::remove_all(folder_, none);
}

void DriveAnimation::add(const ViewFrame& view) {
  const ViewAttack& attack = view.attacks.front();
  const Label& label = view.frame.labels.at(as_size(attack.label));
  const std::size_t camera = std::min(as_size(std::max(0, label.camera)), view.frame.cameras() - 1);
  const std::string photo = fmt::format("{:05}.jpg", frames_.size());
  write_file(folder_ / photo, encode_jpeg(view.frame.image_of(camera), kFrameQuality));
  const BevBox& bev = label.box.bev;
  json frame = {{"photo", photo},
                {"box", {bev.x, bev.y, label.box.bottom, bev.length, bev.width, label.box.height, bev.yaw}},
                {"pixel_from_velo", pixel_from_velo(view.frame.calibration_of(camera))},
                {"patch", nullptr}};
  for (const ViewAttack::Patch& patch : attack.patches) {
    if (patch.camera != camera) continue;
    const std::string name = "patch-" + photo;
    write_file(folder_ / name, encode_jpeg(patch.patch, kFrameQuality));
    frame["patch"] = {{"file", name}, {"at", {patch.rect.u0, patch.rect.v0}}};
  }
  frames_.push_back(std::move(frame));
}

void DriveAnimation::write(const DriveView& drive) {
  write_json(folder_ / "animation.json",
             {{"file", fs::absolute(file_).string()}, {"vehicle", drive.vehicle()}, {"frames", frames_}});
  std::string problem;
  if (run_script("validation/view/animation.py", folder_, &problem) != 0)
    throw Failure(file_.string(), "was not drawn: " + problem, "install python3-pil, which has WebP and GIF");
}

}  // namespace mirage
