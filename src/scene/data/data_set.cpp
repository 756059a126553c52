#include "scene/data/data_set.h"

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/names.h"
#include "scene/road_exposure.h"

namespace mirage {

namespace fs = std::filesystem;

void DataSet::check_id(const std::string& id) const {
  if (const std::string problem = frame_id_problem(id); !problem.empty())
    throw InputError(data_.string(), "frame \"" + id.substr(0, 2 * kLongestFrameId) + "\"", problem,
                     "give one of the names that `mirage view` and results show");
}

std::vector<DataSet::Part> DataSet::existing_parts(const std::string& id) const {
  check_id(id);
  std::vector<Part> all = parts(id);
  for (const Part& part : all)
    if (!fs::is_regular_file(part.file)) {
      if (!fs::exists(part.file.parent_path())) static_cast<void>(frames());  // no data set: it says why
      throw InputError(part.file.string(), "", std::string("missing (") + part.what + " of the frame)",
                       "add the file or drop the frame");
    }
  return all;
}

std::optional<Lighting> DataSet::lighting(const std::string&) const {
  return std::nullopt;
}

std::optional<std::vector<int>> DataSet::tracks(const std::string& id) const {
  const auto [width, height] = picture_size(id);
  std::vector<int> all;
  for (const Label& label : annotations(id, width, height).labels) all.push_back(label.track);
  return all;
}

std::pair<int, int> DataSet::picture_size(const std::string& id) const {
  int width = 0, height = 0;
  read_image_size(parts(id).at(1).file, width, height);
  return {width, height};
}

Frame DataSet::read(const std::string& id) const {
  const std::vector<Part> files = existing_parts(id);
  Frame frame;
  frame.id = id;
  frame.sweep = sweep(id);
  // Header, calibration, pixels: a header that claims too much contradicts the calibration before it costs
  // memory.
  const auto [width, height] = picture_size(id);
  Annotations known = annotations(id, width, height);
  frame.calibration = known.calibration;
  frame.image = read_srgb(files.at(1).file, {width, height});
  frame.labels = std::move(known.labels);
  frame.labelled = known.labelled;
  const auto own = lighting(id);
  frame.lighting = own ? *own : with_road_exposure(frame);
  return frame;
}

std::string DataSet::annotations_hash(const std::string& id) const {
  std::string hashes;
  const std::vector<Part> all = parts(id);
  for (std::size_t i = 2; i < all.size(); ++i) hashes += file_hash(all[i].file, kLargestFile);
  return hashes;
}

std::string DataSet::hash(const std::string& id) const {
  const std::vector<Part> files = existing_parts(id);
  return content_hash(file_hash(files.at(0).file, kLargestFile) + file_hash(files.at(1).file, kLargestFile) +
                      annotations_hash(id));
}

}  // namespace mirage
