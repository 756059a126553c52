#include "frames/host_id.h"

#include <fmt/format.h>

#include <set>

#include "base/error.h"
#include "base/names.h"
#include "base/sizes.h"
#include "scene/data/data_set.h"

namespace mirage {
namespace {

bool carries(const Label& label) {
  return (is_vehicle_type(label.type) || is_sought(label)) && has_box(label);
}

}  // namespace

std::string host_name(const HostId& id) {
  return fmt::format("{}_{}", escape_name(id.frame), id.label);
}

std::vector<std::string> host_frames(std::span<const HostId> hosts) {
  std::set<std::string> frames;
  for (const HostId& host : hosts) frames.insert(host.frame);
  return {frames.begin(), frames.end()};
}

const Label& label_of(const Frame& frame, const HostId& id) {
  if (id.label < 0 || as_size(id.label) >= frame.labels.size())
    throw InputError("run.json", "host " + host_name(id), "is not in the data set",
                     "give the --data folder that the run was made with");
  const Label& label = frame.labels[as_size(id.label)];
  if (!carries(label))
    throw InputError(
        "run.json", "host " + host_name(id),
        fmt::format("is a {}{} in the data set", label.type, has_box(label) ? "" : " without a box in space"),
        "give the --data folder that the run was made with, with its labels");
  return label;
}

const Label& vehicle_of(const Frame& frame, int label, const std::string& option) {
  const auto index = as_size(label);
  const bool in_range = label >= 0 && index < frame.labels.size();
  if (in_range && carries(frame.labels[index])) return frame.labels[index];
  std::string vehicles;
  for (std::size_t i = 0; i < frame.labels.size(); ++i)
    if (carries(frame.labels[i])) vehicles += fmt::format("{}{}", vehicles.empty() ? "" : ", ", i);
  const std::string is =
      !frame.labelled ? "has no labels"
      : !in_range     ? fmt::format("has {} labels, from 0", frame.labels.size())
      : is_vehicle_type(frame.labels[index].type)
          ? "has no box in space for this label"
          : fmt::format("has a {} there, which is not a vehicle", frame.labels[index].type);
  throw InputError(
      option, std::to_string(label), "frame " + frame.id + " " + is,
      vehicles.empty() ? "give a frame with labelled vehicles" : "give one of its vehicles: " + vehicles);
}

}  // namespace mirage
