#include "attack/checkpoint.h"

#include <limits>

#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/names.h"

namespace mirage {
namespace {

nlohmann::json flat(const std::vector<Vec3d>& points) {
  std::vector<double> values;
  for (const Vec3d& p : points) values.insert(values.end(), p.data(), p.data() + 3);
  return values;
}

std::vector<Vec3d> read_points(const JsonFields& json, const char* key, std::size_t count) {
  const auto values = json.numbers(key, 3 * count, -kLargestSize, kLargestSize);
  std::vector<Vec3d> points(count);
  for (std::size_t i = 0; i < count; ++i)
    points[i] = Vec3d(values[3 * i], values[3 * i + 1], values[3 * i + 2]);
  return points;
}

nlohmann::json to_json(const Adam& adam) {
  return {{"step_count", adam.step_count}, {"first", adam.first}, {"second", adam.second}};
}

constexpr double kAny = std::numeric_limits<double>::max();

/// Moments of `count` parameters; none before the first of its steps, which are at most the run's.
void read_adam(const JsonFields& json, std::size_t count, long iteration, Adam& adam) {
  adam.step_count = json.integer("step_count", 0, iteration);
  const std::size_t size = adam.step_count > 0 ? count : 0;
  adam.first = json.numbers("first", size, -kAny, kAny);
  adam.second = json.numbers("second", size, 0, kAny);
}

/// InputError naming the first setting that differs.
void check_identity(const std::filesystem::path& file, const nlohmann::json& written,
                    const nlohmann::json& asked) {
  const nlohmann::json saved = with_unnamed_settings(written), identity = with_unnamed_settings(asked);
  const auto compare = [&](const std::string& key) {
    if (saved.value(key, nlohmann::json()) != identity.value(key, nlohmann::json()))
      throw InputError(file.string(), printable(key), "the folder holds a run with another value",
                       "use another --out folder or the run's own settings");
  };
  const std::string hosts = "train";  // follows from the settings, so the setting is named where one differs
  for (const nlohmann::json* all : {&identity, &saved})  // a key that only one of them has differs as well
    for (const auto& [key, value] : all->items())
      if (key != hosts) compare(key);
  compare(hosts);
}

}  // namespace

AttackState fresh_state(const AttackSettings& settings) {
  AttackState state;
  state.adversary = initial_adversary(settings.limits);
  if (settings.buildable.on) make_buildable(state.adversary, settings.buildable, settings.limits);
  state.vertices.learning_rate = settings.vertex_rate;
  state.texels.learning_rate = settings.texel_rate;
  return state;
}

void write_checkpoint(const std::filesystem::path& file, const AttackState& state,
                      const nlohmann::json& identity) {
  std::vector<double> losses;
  std::vector<int> hidden;
  for (const LossRow& row : state.losses)
    losses.insert(losses.end(), {row.hide, row.false_positive, row.laplacian}), hidden.push_back(row.hidden);
  const nlohmann::json json = {{"identity", identity},
                               {"iteration", state.iteration},
                               {"vertices", flat(state.adversary.mesh.vertices)},
                               {"texels", flat(state.adversary.atlas.texels)},
                               {"adam_vertices", to_json(state.vertices)},
                               {"adam_texels", to_json(state.texels)},
                               {"losses", losses},
                               {"hidden", hidden}};
  write_file(file, json_text(json));
}

AttackState read_checkpoint(const std::filesystem::path& file, const nlohmann::json& identity) {
  const nlohmann::json whole = read_json(file);
  const JsonFields json(file, whole, "delete the file to start the run again");
  json.object("identity");
  check_identity(file, whole.at("identity"), identity);
  AttackState state;
  state.iteration = json.integer("iteration", 0, kMostIterations);
  Vec3d half;
  for (int c = 0; c < 3; ++c) half[c] = identity.at("limits").at(static_cast<std::size_t>(c));
  state.adversary = initial_adversary({half});
  auto& vertices = state.adversary.mesh.vertices;
  auto& texels = state.adversary.atlas.texels;
  vertices = read_points(json, "vertices", vertices.size());
  texels = read_points(json, "texels", texels.size());
  TexturedMesh within = state.adversary;
  project(within, {half});
  if (within.mesh.vertices != vertices) json.fail("vertices", "one lies outside the box of the run's size");
  if (within.atlas.texels != texels) json.fail("texels", "one is not in [0, 1]");
  state.vertices.learning_rate = identity.at("vertex_rate");
  state.texels.learning_rate = identity.at("texel_rate");
  read_adam(json.object("adam_vertices"), 3 * vertices.size(), state.iteration, state.vertices);
  read_adam(json.object("adam_texels"), 3 * texels.size(), state.iteration, state.texels);
  const auto rows = static_cast<std::size_t>(state.iteration);  // one a step
  const auto losses = json.numbers("losses", 3 * rows, -kAny, kAny);
  for (std::size_t i = 0; i < losses.size(); i += 3)
    state.losses.push_back({losses[i], losses[i + 1], losses[i + 2]});
  if (!json.has("hidden")) return state;  // checkpoints of before
  const auto hidden = json.numbers("hidden", rows, -1, std::numeric_limits<int>::max());
  for (std::size_t i = 0; i < rows; ++i) state.losses[i].hidden = static_cast<int>(hidden[i]);
  return state;
}

}  // namespace mirage
