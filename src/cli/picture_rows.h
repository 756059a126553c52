// What the commands print about a detector's use of its picture.
#pragma once

#include "cli/table.h"
#include "detection/reliance.h"

namespace mirage::cli {

inline Rows picture_rows(const Reliance& reliance) {
  Rows rows = {{"use of the picture", describe(reliance)}};
  if (const std::string note = picture_note(reliance); !note.empty()) rows.push_back({"images", note});
  return rows;
}

}  // namespace mirage::cli
