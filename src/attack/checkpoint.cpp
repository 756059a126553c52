#include "attack/checkpoint.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "attack/run.h"
#include "base/error.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/names.h"
#include "base/provenance.h"
#include "base/ranks.h"
#include "base/sizes.h"

namespace mirage {
namespace {

constexpr const char* kStartAgain = "delete the file to start the run again";

nlohmann::json flat(const std::vector<Vec3d>& points) {
  std::vector<double> values;
  for (const Vec3d& p : points) values.insert(values.end(), p.data(), p.data() + 3);
  return values;
}

std::vector<Vec3d> read_points(const JsonFields& json, const char* key, std::size_t count) {
  const auto values = json.numbers(key, 3 * count, -kMaxAdversarySize, kMaxAdversarySize);
  std::vector<Vec3d> points(count);
  for (std::size_t i = 0; i < count; ++i)
    points[i] = Vec3d(values[3 * i], values[3 * i + 1], values[3 * i + 2]);
  return points;
}

nlohmann::json to_json(const Adam& adam) {
  return {{"step_count", adam.step_count}, {"first", adam.first}, {"second", adam.second}};
}

constexpr double kAny = std::numeric_limits<double>::max();

/// Reads the moments of `count` parameters; empty before the first step. step_count is at most `iteration`.
void read_adam(const JsonFields& json, std::size_t count, long iteration, Adam& adam) {
  adam.step_count = json.integer("step_count", 0, iteration);
  const std::size_t size = adam.step_count > 0 ? count : 0;
  adam.first = json.numbers("first", size, -kAny, kAny);
  adam.second = json.numbers("second", size, 0, kAny);
}

/// Reads the fields "vertices" and "texels" into `mesh`, which already has as many of both.
void read_mesh(const JsonFields& json, const AdversaryLimits& limits, TexturedMesh& mesh) {
  mesh.mesh.vertices = read_points(json, "vertices", mesh.mesh.vertices.size());
  mesh.atlas.texels = read_points(json, "texels", mesh.atlas.texels.size());
  TexturedMesh within = mesh;
  project(within, limits);
  if (within.mesh.vertices != mesh.mesh.vertices)
    json.fail("vertices", "one lies outside the box of the run's size");
  if (within.atlas.texels != mesh.atlas.texels) json.fail("texels", "one is not in [0, 1]");
}

void read_held_out(const JsonFields& json, const AdversaryLimits& limits, AttackState& state) {
  HeldOutRecord& record = state.held_out;
  const std::size_t count = json.list("iterations", as_size(state.iteration) + 1).size();
  if (count == 0) json.fail("iterations", "is empty");
  long before = -1;
  for (const double at : json.numbers("iterations", count, 0, static_cast<double>(state.iteration))) {
    if (!(at > static_cast<double>(before)) || at != std::floor(at)) json.fail("iterations", "does not rise");
    record.iterations.push_back(before = static_cast<long>(at));
  }
  record.values = json.numbers("values", count, -kAny, kAny);
  const auto lowest = std::min_element(record.values.begin(), record.values.end());
  record.best = *lowest;
  record.best_iteration = record.iterations[as_size(lowest - record.values.begin())];
  if (json.integer("best_iteration", 0, state.iteration) != record.best_iteration)
    json.fail("best_iteration", "is not that of the lowest value");
  record.mesh = state.adversary;
  read_mesh(json, limits, record.mesh);
}

/// The field "iteration" alone; 0 if it is missing.
std::size_t claimed_iteration(const std::filesystem::path& file) {
  using Event = nlohmann::json::parse_event_t;
  bool at_iteration = false;
  const auto head =
      read_json_parts(file, kStartAgain, [&](int depth, Event event, const nlohmann::json& value) {
        if (event == Event::key) return at_iteration = depth == 1 && value == "iteration";
        return depth == 0 || event == Event::array_start || event == Event::object_start ||
               (depth == 1 && event == Event::value && at_iteration);
      });
  const auto found = head.is_object() ? head.find("iteration") : head.end();
  if (found == head.end() || !found->is_number_unsigned()) return 0;
  return std::min<std::size_t>(found->get<std::size_t>(), kMaxIterations);
}

/// Reads the file if it has no more values than its mesh and steps explain. Parsed values take up to eighty
/// bytes each, thirty times the file's size.
nlohmann::json read_bounded(const std::filesystem::path& file, const TexturedMesh& start) {
  constexpr std::size_t kBeside = 200'000, kBytesBeside = 1 << 22;  // hosts and settings: as run.json
  constexpr std::size_t kMeshes = 5;          // the mesh, two moments, the best one, the rendered one
  constexpr std::size_t kRow = 5, kHeld = 2;  // losses and counts of a step; validation values of a step
  constexpr std::size_t kBytes = 64;          // of a number with its separator
  const std::size_t steps = claimed_iteration(file);
  const std::size_t numbers = 3 * (start.mesh.vertices.size() + start.atlas.texels.size());
  const std::size_t values = kMeshes * numbers + (kRow + kHeld) * (steps + 1);
  if (kRow * steps > OpenFile(file).size())  // otherwise it would allow any number of values
    throw InputError(file.string(), "iteration", "the file is too small for the losses of so many",
                     kStartAgain);
  const std::string text = read_file(file, kBytesBeside + kBytes * values);
  check_json_values(text, file.string(), kBeside + values, kBeside);
  return parse_json(text, file.string());
}

}  // namespace

void check_identity(const std::filesystem::path& file, nlohmann::json written, const RunIdentity& identity) {
  complete(written, identity.lacking);
  const nlohmann::json& expected = identity.json;
  const auto compare = [&](const std::string& key) {
    if (written.value(key, nlohmann::json()) == expected.value(key, nlohmann::json())) return;
    if (!expected.contains(key))
      throw InputError(file.string(), key, "the run in this folder has this setting, and yours does not",
                       "use another --out folder");
    throw InputError(file.string(), key, "the run in this folder has another value",
                     "use another --out folder or the run's own settings");
  };
  // The hosts follow from the settings, so a differing setting is named first.
  const std::vector<std::string> hosts = {"train", kTrainFrames, kTestFrames};
  for (const nlohmann::json* all :
       {&expected, &std::as_const(written)})  // a key in only one of them differs as well
    for (const auto& [key, value] : all->items())
      if (std::ranges::find(hosts, key) == hosts.end()) compare(key);
  for (const std::string& key : hosts) compare(key);
}

void HeldOutRecord::add(long iteration, double value, const TexturedMesh& adversary) {
  iterations.push_back(iteration);
  values.push_back(value);
  if (best_iteration >= 0 && !(value < best)) return;
  best_iteration = iteration;
  best = value;
  mesh = adversary;
}

bool HeldOutRecord::plateau(int steps) const {
  return !iterations.empty() && iterations.back() - best_iteration >= steps;
}

AttackState fresh_state(const AttackSettings& settings) {
  AttackState state;
  state.adversary = initial_adversary(settings.limits);
  if (settings.buildable.on) make_buildable(state.adversary, settings.buildable, settings.limits);
  state.vertices.learning_rate = settings.vertex_rate;
  state.texels.learning_rate = settings.texel_rate;
  return state;
}

void require_one_file(const std::filesystem::path& file, long steps, const char* what) {
  if (any_rank(steps != first_rank_value(steps)))
    throw Failure(file.string(), fmt::format("processes see different {}", what),
                  "give --out a folder that all machines share");
}

nlohmann::json losses_json(const std::vector<LossRow>& rows) {
  std::vector<double> losses;
  std::vector<int> hidden, found;
  for (const LossRow& row : rows) {
    losses.insert(losses.end(), {row.hide, row.false_positive, row.laplacian});
    hidden.push_back(row.hidden), found.push_back(row.found);
  }
  return {{"losses", losses}, {"hidden", hidden}, {"found", found}};
}

std::vector<LossRow> read_losses(const JsonFields& json, std::size_t count) {
  const auto losses = json.numbers("losses", 3 * count, -kAny, kAny);
  const auto hidden = json.numbers("hidden", count, 0, std::numeric_limits<int>::max());
  const auto found = json.numbers("found", count, 0, std::numeric_limits<int>::max());
  std::vector<LossRow> rows;
  for (std::size_t i = 0; i < count; ++i)
    rows.push_back({losses[3 * i], losses[3 * i + 1], losses[3 * i + 2], static_cast<int>(found[i]),
                    static_cast<int>(hidden[i])});
  return rows;
}

void write_losses(const std::filesystem::path& file, const std::vector<LossRow>& rows) {
  std::string text = "iteration,loss,hide,false_positive,laplacian,hidden,found\n";
  for (std::size_t i = 0; i < rows.size(); ++i)
    text += fmt::format("{},{:.9g},{:.9g},{:.9g},{:.9g},{},{}\n", i, rows[i].loss(), rows[i].hide,
                        rows[i].false_positive, rows[i].laplacian, rows[i].hidden, rows[i].found);
  write_file(file, text);
}

void write_checkpoint(const std::filesystem::path& file, const AttackState& state,
                      const nlohmann::json& identity) {
  nlohmann::json json = {{"identity", identity},
                         {"program", program_identity()},
                         {"iteration", state.iteration},
                         {"vertices", flat(state.adversary.mesh.vertices)},
                         {"texels", flat(state.adversary.atlas.texels)},
                         {"adam_vertices", to_json(state.vertices)},
                         {"adam_texels", to_json(state.texels)}};
  json.update(losses_json(state.losses));
  if (const HeldOutRecord& record = state.held_out; !record.iterations.empty())
    json["held_out"] = {{"iterations", record.iterations},
                        {"values", record.values},
                        {"best_iteration", record.best_iteration},
                        {"vertices", flat(record.mesh.mesh.vertices)},
                        {"texels", flat(record.mesh.atlas.texels)}};
  if (state.rendered.iteration >= 0)
    json["rendered"] = {{"iteration", state.rendered.iteration},
                        {"vertices", flat(state.rendered.mesh.mesh.vertices)},
                        {"texels", flat(state.rendered.mesh.atlas.texels)}};
  write_file(file, json_text(json));
}

AttackState read_checkpoint(const std::filesystem::path& file, const RunIdentity& identity,
                            const AttackSettings& settings) {
  return read_checkpoint(file, identity, settings, initial_adversary(settings.limits));
}

AttackState read_checkpoint(const std::filesystem::path& file, const RunIdentity& identity,
                            const AttackSettings& settings, const TexturedMesh& start) {
  const nlohmann::json whole = read_bounded(file, start);
  const JsonFields json(file, whole, kStartAgain);
  json.object("identity");
  check_identity(file, whole.at("identity"), identity);
  AttackState state;
  state.iteration = json.integer("iteration", 0, kMaxIterations);
  if (json.has("program") && json.text("program") != program_identity())
    spdlog::warn(
        "{}: {} steps were made by another version of Mirage or on another processor; to repeat all of them "
        "with this one, use another --out",
        file.string(), state.iteration);
  const AdversaryLimits& limits = settings.limits;
  state.adversary = start;
  const auto& vertices = state.adversary.mesh.vertices;
  const auto& texels = state.adversary.atlas.texels;
  read_mesh(json, limits, state.adversary);
  state.vertices.learning_rate = settings.vertex_rate;
  state.texels.learning_rate = settings.texel_rate;
  const bool size_alone = settings.parts == AttackParts::size;  // three numbers are learned
  read_adam(json.object("adam_vertices"), size_alone ? 3 : 3 * vertices.size(), state.iteration,
            state.vertices);
  read_adam(json.object("adam_texels"), 3 * texels.size(), state.iteration, state.texels);
  state.losses = read_losses(json, as_size(state.iteration));  // one a step
  if (json.has("held_out")) read_held_out(json.object("held_out"), limits, state);
  if (json.has("rendered")) {
    const JsonFields rendered = json.object("rendered");
    state.rendered = {rendered.integer("iteration", 0, state.iteration), state.adversary};
    read_mesh(rendered, limits, state.rendered.mesh);
  }
  return state;
}

}  // namespace mirage
