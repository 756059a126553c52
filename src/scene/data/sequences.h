// The drives, scenes or sequences of a data set: their frames in order of time.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "base/fields.h"
#include "scene/data/data_set.h"

namespace mirage {

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
  visit({.name = "sequence", .help = "drive, scene or sequence of the data set; default: all"}, s.sequence);
  visit({.name = "frames",
         .help = "numbers of frames, A:B with both counted; A: and :B leave an end open; default: all",
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

}  // namespace mirage
