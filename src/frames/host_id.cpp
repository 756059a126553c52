#include "frames/host_id.h"

#include <fmt/format.h>

#include "base/error.h"
#include "base/names.h"

namespace mirage {

std::string host_name(const HostId& id) {
  return fmt::format("{}_{}", escape_name(id.frame), id.label);
}

const Label& label_of(const Frame& frame, const HostId& id) {
  if (id.label < 0 || static_cast<std::size_t>(id.label) >= frame.labels.size())
    throw InputError("run.json", "host " + host_name(id), "is not in the data set",
                     "give the --data folder that the run was made with");
  return frame.labels[static_cast<std::size_t>(id.label)];
}

}  // namespace mirage
