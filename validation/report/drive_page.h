// The page of `mirage drive`: one strip a vehicle, time against distance.
#pragma once

#include <filesystem>

namespace mirage {

/// Writes OUT/drive.html from OUT/result.json (validation/report/drive.py): one self-contained file. A
/// warning in its place where Python or jinja2 is missing.
void write_drive_page(const std::filesystem::path& out);

}  // namespace mirage
