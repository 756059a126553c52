// What the labels of a data set hold, counted once by each command, so that none of them says nothing in
// silence: types that nobody knows, frames without labels, boxes that had to be mended.
#pragma once

#include <filesystem>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "scene/data/data_set.h"
#include "scene/data/label_types.h"

namespace mirage {

/// The labels of some frames, counted. DontCare regions are none.
struct LabelCensus {
  std::filesystem::path data;
  std::string incomplete;  ///< DataSet::incomplete()
  std::size_t frames = 0;
  std::size_t unlabelled = 0;        ///< frames that nobody has labelled
  std::map<std::string, int> types;  ///< labels by type
  int labels = 0;
  int in_picture_alone = 0;                    ///< labels that say nothing of the box in space
  int cars = 0;                                ///< of the classes that are sought, with a box in space
  std::vector<std::string> classes = {kCars};  ///< those
  LabelNotes notes;
};
/// Reads the labels of these frames, in all cameras if so asked. InputError as DataSet::annotations(), and
/// for a class (classes_of) that is neither known nor in the data: it names those that are there.
LabelCensus count_labels(const std::filesystem::path& data, std::span<const std::string> ids,
                         const std::string& classes = kCars, Cameras cameras = Cameras::first);

/// Logs a warning for each of: types that are not known, cars that are missing altogether, frames without
/// labels, labels of the picture alone, and boxes in the picture that were clipped or projected.
void warn_of_labels(const LabelCensus& census);
/// InputError where nothing that is sought is labelled in space: it says what is, and what can be done.
/// `work`: what needs them ("an attack").
void require_cars(const LabelCensus& census, const std::string& work);
/// InputError where no label has one of these types, which are named as kitti_type names them.
void require_types(const LabelCensus& census, std::span<const std::string> types, const std::string& option);

}  // namespace mirage
