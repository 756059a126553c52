// What commands tell: short tables on standard output, and pages.
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "base/child_process.h"
#include "base/intervals.h"
#include "base/logging.h"
#include "base/names.h"
#include "detection/reliance.h"

namespace mirage::cli {

using Rows = std::vector<std::pair<std::string, std::string>>;

inline void print_table(const Rows& rows) {
  std::size_t widest = 0;
  for (const auto& [name, value] : rows) widest = std::max(widest, name.size());
  for (const auto& [name, value] : rows)
    std::fputs(fmt::format("{:<{}}  {}\n", name, widest, printable(value)).c_str(), stdout);
  std::fflush(stdout);
}

/// Letters of UTF-8, each a column.
inline std::size_t columns(const std::string& text) {
  return static_cast<std::size_t>(
      std::count_if(text.begin(), text.end(), [](char c) { return (c & 0xC0) != 0x80; }));
}

/// Rows of cells, the first row the heads.
using Columns = std::vector<std::vector<std::string>>;

/// After an empty line; a row may have fewer cells than the others.
inline void print_columns(const Columns& rows) {
  std::vector<std::size_t> widest;
  for (const auto& row : rows)
    for (std::size_t i = 0; i < row.size(); ++i) {
      if (widest.size() <= i) widest.push_back(0);
      widest[i] = std::max(widest[i], columns(printable(row[i])));
    }
  std::fputs("\n", stdout);
  for (const auto& row : rows) {
    std::string line;
    for (std::size_t i = 0; i < row.size(); ++i) {
      const std::string cell = printable(row[i]);
      line += cell;
      if (i + 1 < row.size()) line.append(widest[i] + 2 - columns(cell), ' ');
    }
    std::fputs((line + "\n").c_str(), stdout);
  }
  std::fflush(stdout);
}

inline std::string percent(double share) {
  return fmt::format("{:.1f} %", 100 * share);
}

/// "20.8 % (8.3–37.5)"
inline std::string percent(double share, double low, double high) {
  return fmt::format("{} ({:.1f}–{:.1f})", percent(share), 100 * low, 100 * high);
}

inline std::string percent(const Interval& share) {
  return percent(share.value, share.low, share.high);
}

/// Of a difference of shares, in points: "+9.2 (+3.4 to +16.2)"
inline std::string signed_points(const Interval& difference) {
  return fmt::format("{:+.1f} ({:+.1f} to {:+.1f})", 100 * difference.value, 100 * difference.low,
                     100 * difference.high);
}

// What the commands print about a detector's use of its picture.

inline Rows picture_rows(const Reliance& reliance) {
  Rows rows = {{"use of the picture", describe(reliance)}};
  if (const std::string note = picture_note(reliance); !note.empty()) rows.push_back({"images", note});
  return rows;
}

/// The page that a Python program makes beside OUT/result.json, one self-contained file
/// (validation/report/command_page.py). A warning in its place where Python or jinja2 is missing.
inline void write_page(const std::filesystem::path& out) {
  std::string said;
  if (run_script("validation/report/command_page.py", out, &said) != 0)
    spdlog::warn("no page beside {}: {}", (out / "result.json").string(),
                 said.empty() ? "install python3-jinja2 and python3-pil" : said);
}

}  // namespace mirage::cli
