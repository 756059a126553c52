#include "generator/vehicle_truth.h"

#include <charconv>

#include "base/error.h"
#include "base/files.h"
#include "generator/dataset.h"
#include "generator/street.h"
#include "geometry/shapes.h"

namespace mirage::generator {

std::vector<TrueVehicle> true_vehicles(std::uint64_t seed, std::uint64_t index, double height, Look look) {
  const Street street = make_street(seed, index, height, look);
  std::vector<TrueVehicle> vehicles;
  for (const Placed& placed : street.placed) vehicles.push_back({placed.type, placed.box, {}, placed.kind});
  for (const Surface& surface : street.surfaces)
    if (const auto k = static_cast<std::size_t>(surface.object);
        surface.object >= 0 && !on_roof(surface, street.placed[k]))
      append(vehicles[k].mesh, surface.mesh, Transform::Identity());
  return vehicles;
}

std::optional<StreetSource> source_of(const std::filesystem::path& data) {
  const auto file = data / "dataset.json";
  if (!std::filesystem::exists(file)) return std::nullopt;
  const nlohmann::json about = read_json(file, kLargestRecord);
  if (!about.is_object() || !about.contains("seed") || !about.at("seed").is_number_unsigned() ||
      !about.contains("generator"))
    throw InputError(file.string(), "seed", "missing or not a whole number",
                     "make the data set again with: mirage generate");
  if (about.at("generator") != kGeneratorVersion) return std::nullopt;
  const nlohmann::json look = about.value("look", nlohmann::json(name_of(Look::european)));
  if (!look.is_string())
    throw InputError(file.string(), "look", "is no text", "make the data set again with: mirage generate");
  return StreetSource{about.at("seed").get<std::uint64_t>(), parse_look(look, file.string(), "look")};
}

std::optional<std::uint64_t> index_of(const std::string& frame) {
  std::uint64_t index = 0;
  const char *first = frame.data(), *last = first + frame.size();
  const auto [end, problem] = std::from_chars(first, last, index);
  return problem == std::errc() && end == last ? std::optional(index) : std::nullopt;
}

const TrueVehicle* find_vehicle(const std::vector<TrueVehicle>& vehicles, const std::string& type,
                                const Box3& box) {
  const TrueVehicle* best = nullptr;
  double nearest = 0.1;
  for (const TrueVehicle& v : vehicles) {
    const double d =
        Vec3d(v.box.bev.x - box.bev.x, v.box.bev.y - box.bev.y, v.box.bottom - box.bottom).norm();
    if (v.type != type || d >= nearest) continue;
    nearest = d;
    best = &v;
  }
  return best;
}

}  // namespace mirage::generator
