#include <fmt/format.h>

#include <set>

#include "validation/paper/matrix_markdown.h"
#include "validation/paper/tables.h"

namespace mirage::paper {
namespace {

/// "31.9 (24.1–40.0)", per cent.
std::string cell(const Share& share) {
  const Interval& interval = share.interval;
  if (!share.bounded) return fmt::format("{:.1f}", 100 * interval.value);
  return fmt::format("{:.1f} ({:.1f}–{:.1f})", 100 * interval.value, 100 * interval.low, 100 * interval.high);
}

/// ", 3 runs"
std::string more_than_one(int count, const char* what) {
  return count > 1 ? fmt::format(", {} {}", count, what) : "";
}

/// A bar in a cell would end it.
std::string escaped(const std::string& text) {
  std::string escaped_text;
  for (const char c : text) escaped_text += c == '|' ? "\\|" : c == '\n' ? " " : std::string(1, c);
  return escaped_text;
}

/// What the row's numbers rest on, and what is to be said of them.
std::string remarks(const RowResult& row) {
  std::string text;
  if (const auto& counts = row.counts)
    text = fmt::format("{} in {} frames{}{}", counts->vehicles, counts->frames,
                       more_than_one(counts->meshes, "meshes"), more_than_one(counts->runs, "runs"));
  if (!row.note.empty()) text += "; " + escaped(row.note);
  if (!row.error.empty()) text += (row.counts ? "; " : "") + escaped(row.error);
  return text;
}

}  // namespace

std::string markdown(const TableResult& table) {
  if (table.matrix) return matrix_markdown(table);
  std::string text = fmt::format("## {}: {}\n\n", table.name, table.title);
  if (!table.note.empty()) text += table.note + "\n\n";
  bool rigs = false;
  std::set<std::string> paper;  // the columns for which the paper has a number
  for (const RowResult& row : table.rows) {
    rigs = rigs || row.rig != table.rows.front().rig;
    for (const auto& [key, value] : row.paper) paper.insert(key);
  }
  text += rigs ? "| data | |" : "| |";
  std::string rule = rigs ? "|---|---|" : "|---|";
  for (const Column& column : table.columns) {
    text += fmt::format(" {}, % |", column.title);
    rule += "---|";
    if (paper.contains(column.key)) text += " paper |", rule += "---|";
  }
  text += " vehicles | minutes |\n" + rule + "---|---|\n";
  for (const RowResult& row : table.rows) {
    text += rigs ? fmt::format("| {} | {} |", row.rig, escaped(row.label))
                 : fmt::format("| {} |", escaped(row.label));
    for (const auto& [key, title] : table.columns) {
      const auto value = row.values.find(key);
      text += value == row.values.end() ? " – |" : fmt::format(" {} |", cell(value->second));
      if (!paper.contains(key)) continue;
      const auto printed = row.paper.find(key);
      text += printed == row.paper.end() ? " |" : fmt::format(" {:.2f} |", 100 * printed->second);
    }
    text += fmt::format(" {} |", remarks(row));
    text += row.minutes ? fmt::format(" {:.1f} |\n", *row.minutes) : " |\n";
  }
  return text + "\n";
}

}  // namespace mirage::paper
