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

/// Opens the data set in a folder by its content. An unknown layout is opened as KITTI's object benchmark,
/// whose frames() then refuses it.
std::shared_ptr<const DataSet> open_data_set(const std::filesystem::path& data,
                                             Cameras cameras = Cameras::first);

/// As DataSet::frames(), or the first `limit` of them (0: all).
std::vector<std::string> list_frames(const std::filesystem::path& data, std::size_t limit = 0);
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
/// Frames in order of time, at least one.
struct Sequence {
  std::string name;
  std::vector<SequenceFrame> frames;
};

/// A part of a data set's sequences.
struct SequencePart {
  std::string sequence = {};  ///< its name; empty: all
  std::string frames = {};    ///< "A:B", frame numbers from A to B, inclusive; A or B may be left out
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

/// The part's sequences by name. InputError naming the set if its frames have no sequence or no pose of the
/// car, if it has no such sequence (names the nearest), no frame in that range, or two frames of the same
/// time.
std::vector<Sequence> read_sequences(const std::filesystem::path& data, const SequencePart& part = {});

// Statistics of a data set's labels, counted once by each command, so that problems are reported: unknown
// types, frames without labels, corrected boxes.

/// Counts of the labels of some frames, without DontCare regions.
struct LabelCensus {
  std::filesystem::path data;
  std::string incomplete;  ///< DataSet::incomplete()
  std::size_t frames = 0;
  std::size_t unlabelled = 0;        ///< frames that are not labelled
  std::map<std::string, int> types;  ///< labels by type
  int labels = 0;
  int in_picture_alone = 0;                    ///< labels without a 3-D box
  int cars = 0;                                ///< labels of the classes sought, with a 3-D box
  std::vector<std::string> classes = {kCars};  ///< the classes sought
  LabelNotes notes;
};
/// Reads the labels of these frames, of all cameras if requested. InputError as DataSet::annotations(), and
/// for a class (classes_of) that is neither known nor in the data; it names the classes in the data.
LabelCensus count_labels(const std::filesystem::path& data, std::span<const std::string> ids,
                         const std::string& classes = kCars, Cameras cameras = Cameras::first);

/// Logs a warning for each of: incomplete frames, unknown types, no cars at all, frames without labels,
/// labels with a 2-D box only, and 2-D boxes that were clipped or projected.
void warn_of_labels(const LabelCensus& census);
/// InputError if no label of a class sought has a 3-D box; it says what is labelled and suggests a fix.
/// `work`: the task that needs them ("an attack").
void require_cars(const LabelCensus& census, const std::string& work);
/// count_labels, require_cars and, on the first rank, warn_of_labels.
LabelCensus check_labels(const std::filesystem::path& data, std::span<const std::string> ids,
                         const std::string& work, const std::string& classes = kCars,
                         Cameras cameras = Cameras::first);
/// InputError if no label has one of these types (named as by kitti_type).
void require_types(const LabelCensus& census, std::span<const std::string> types, const std::string& option);

}  // namespace mirage
