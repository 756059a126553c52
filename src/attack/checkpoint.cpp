#include "attack/checkpoint.h"

#include <algorithm>

#include "base/error.h"
#include "base/files.h"

namespace mirage {
namespace {

nlohmann::json flat(const std::vector<Vec3d>& points) {
  std::vector<double> values;
  for (const Vec3d& p : points) values.insert(values.end(), p.data(), p.data() + 3);
  return values;
}

std::vector<Vec3d> points_from(const nlohmann::json& json, std::size_t expected) {
  const auto values = json.get<std::vector<double>>();
  if (values.size() != 3 * expected) throw std::invalid_argument("a list has the wrong length");
  std::vector<Vec3d> points(expected);
  for (std::size_t i = 0; i < expected; ++i)
    points[i] = Vec3d(values[3 * i], values[3 * i + 1], values[3 * i + 2]);
  return points;
}

nlohmann::json to_json(const Adam& adam) {
  return {{"step_count", adam.step_count}, {"first", adam.first}, {"second", adam.second}};
}

void read_adam(const nlohmann::json& json, Adam& adam) {
  adam.step_count = json.at("step_count");
  adam.first = json.at("first").get<std::vector<double>>();
  adam.second = json.at("second").get<std::vector<double>>();
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
  write_file(file, json.dump());
}

AttackState read_checkpoint(const std::filesystem::path& file, const nlohmann::json& identity) {
  const nlohmann::json json = read_json(file);
  AttackState state;
  try {
    const auto& saved = json.at("identity");
    const auto compare = [&](const std::string& key) {
      if (saved.value(key, nlohmann::json()) != identity.value(key, nlohmann::json()))
        throw InputError(file.string(), key, "the folder holds a run with another value",
                         "use another --out folder or the run's own settings");
    };
    const std::string hosts =
        "train";  // follows from the settings, so the setting is named where one differs
    for (const nlohmann::json* all : {&identity, &saved})  // a key that only one of them has differs as well
      for (const auto& [key, value] : all->items())
        if (key != hosts) compare(key);
    compare(hosts);
    state.iteration = json.at("iteration");
    Vec3d half;
    for (int c = 0; c < 3; ++c) half[c] = identity.at("limits").at(static_cast<std::size_t>(c));
    state.adversary = initial_adversary({half});
    state.adversary.mesh.vertices = points_from(json.at("vertices"), state.adversary.mesh.vertices.size());
    state.adversary.atlas.texels = points_from(json.at("texels"), state.adversary.atlas.texels.size());
    state.vertices.learning_rate = identity.at("vertex_rate");
    state.texels.learning_rate = identity.at("texel_rate");
    read_adam(json.at("adam_vertices"), state.vertices);
    read_adam(json.at("adam_texels"), state.texels);
    const auto losses = json.at("losses").get<std::vector<double>>();
    for (std::size_t i = 0; i + 2 < losses.size(); i += 3)
      state.losses.push_back({losses[i], losses[i + 1], losses[i + 2]});
    const auto hidden = json.value("hidden", std::vector<int>());  // checkpoints of before have none
    for (std::size_t i = 0; i < std::min(hidden.size(), state.losses.size()); ++i)
      state.losses[i].hidden = hidden[i];
  } catch (const InputError&) {
    throw;
  } catch (const std::exception& error) {
    throw InputError(file.string(), "checkpoint", error.what(), "delete the file to start the run again");
  }
  return state;
}

}  // namespace mirage
