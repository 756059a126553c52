// Frames of a data set of any layout (data_set.h), by its folder.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "base/fields.h"
#include "scene/data/data_set.h"

namespace mirage {

/// The data set in a folder, by what the folder holds. An unknown layout is opened as an empty set of KITTI's
/// object benchmark, which frames() then refuses.
std::shared_ptr<const DataSet> open_data_set(const std::filesystem::path& data,
                                             Cameras cameras = Cameras::first);

/// As DataSet::frames().
std::vector<std::string> list_frames(const std::filesystem::path& data);
/// As DataSet::read().
Frame read_frame(const std::filesystem::path& data, const std::string& id, Cameras cameras = Cameras::first);
/// As DataSet::annotations().
Annotations read_annotations(const std::filesystem::path& data, const std::string& id,
                             Cameras cameras = Cameras::first);

// The drives, scenes or sequences of a data set: their frames in order of time.

/// A frame of a sequence.
struct SequenceFrame {
  std::string id;
  Moment moment;
};
/// Frames by rising time, at least one.
struct Sequence {
  std::string name;
  std::vector<SequenceFrame> frames;
};

/// Which part of a data set's sequences.
struct SequencePart {
  std::string sequence = {};  ///< its name; empty: all
  std::string frames = {};    ///< "A:B", numbers of frames from A to B, both counted; A or B may be left out
  bool between = false;       ///< also sweeps between labelled frames (DataSet::sweeps)
};

/// FieldError for `frames` of another form.
void check_frame_range(const std::string& frames);

template <class Visitor, FieldsOf<SequencePart> S>
void visit_fields(Visitor& visit, S& s) {
  visit({.name = "sequence", .help = "drive, scene or sequence of the data set", .otherwise = "all"},
        s.sequence);
  visit({.name = "frames",
         .help = "numbers of frames, A:B with both counted; A: and :B leave an end open",
         .otherwise = "all",
         .check = check_frame_range},
        s.frames);
  visit({.name = "between",
         .help = "nuScenes: also the sweeps between key frames, 20 a second, with boxes between theirs",
         .lacking = "false"},
        s.between);
}

/// The part's sequences by name. InputError naming the set if its frames are of no sequence or the car's pose
/// is not known, if it has no such sequence (it names the nearest), no frame of those numbers, or two frames
/// of one time.
std::vector<Sequence> read_sequences(const std::filesystem::path& data, const SequencePart& part = {});

// What the labels of a data set hold, counted once by each command, so that none of them says nothing in
// silence: types that nobody knows, frames without labels, boxes that had to be mended.

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
