// What was written of a generated frame: training/written/ID.json, {"image_2/ID.png": content hash, …}. A
// frame is taken for whole by its content; that its files exist says nothing after a full disk or a power
// cut.
#pragma once

#include <filesystem>
#include <string>

#include "scene/data/truth_files.h"

namespace mirage {

/// Writes the record from the frame's files, after the last of them. Truth recorded before stays recorded.
void record_frame(const std::filesystem::path& data, const std::string& id, Truth truth);

/// True if the record has all files of the frame and of this much truth, and each is as recorded. A file that
/// differs (cut short, edited) is warned of.
bool is_as_recorded(const std::filesystem::path& data, const std::string& id, Truth truth);

}  // namespace mirage
