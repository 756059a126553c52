#include "validation/paper/matrix_markdown.h"

#include <fmt/format.h>

#include <algorithm>
#include <map>
#include <vector>

namespace mirage::paper {
namespace {

/// The cell's row, if it has one.
const RowResult* find(const TableResult& table, const std::string& source, const std::string& target) {
  for (const RowResult& row : table.rows)
    if (row.source == source && row.target == target) return &row;
  return nullptr;
}

std::vector<std::string> each_once(const TableResult& table, std::string RowResult::*end) {
  std::vector<std::string> names;
  for (const RowResult& row : table.rows)
    if (std::find(names.begin(), names.end(), row.*end) == names.end()) names.push_back(row.*end);
  return names;
}

/// "8.6; +7.1 (+0.0 to +17.5)"
std::string cell_text(const std::map<std::string, Share>& values, const std::string& key) {
  const auto share = values.find(key), beside = values.find("net_" + key);
  if (share == values.end()) return "–";
  std::string text = fmt::format("{:.1f}", 100 * share->second.interval.value);
  if (beside == values.end()) return text;
  const Interval& net = beside->second.interval;
  text += fmt::format("; {:+.1f} ({:+.1f} to {:+.1f})", 100 * net.value, 100 * net.low, 100 * net.high);
  for (std::size_t at; (at = text.find('-')) != std::string::npos;) text.replace(at, 1, "−");
  // A sign would say more of a zero than is known.
  for (const char* zero : {"+0.0", "−0.0"})
    for (std::size_t at; (at = text.find(zero)) != std::string::npos;)
      text.replace(at, std::string(zero).size(), "0.0");
  return text;
}

}  // namespace

std::string matrix_markdown(const TableResult& table) {
  const auto sources = each_once(table, &RowResult::source), targets = each_once(table, &RowResult::target);
  std::string text = fmt::format("## {}: {}\n\n{}\n\n", table.name, table.title, table.note);
  std::string head = " |", rule = "|---|";
  for (const std::string& target : targets) head += " " + target + " |", rule += "---|";
  for (const auto& [key, title] : table.columns) {
    if (key.starts_with("net")) continue;
    text +=
        fmt::format("| {}, %{}{}\n{}\n", title, key == "fp_asr" ? "" : "; net, points (95 %)", head, rule);
    for (const std::string& source : sources) {
      text += "| " + source + " |";
      for (const std::string& target : targets) {
        const RowResult* row = find(table, source, target);
        const std::string cell = row ? cell_text(row->values, key) : "–";
        text += source.starts_with(target + ",") ? " **" + cell + "** |" : " " + cell + " |";
      }
      text += "\n";
    }
    text += "\n";
  }
  text += "| vehicles found clean at IoU 0.7 |" + head.substr(2) + "\n" + rule + "\n| in frames |";
  for (const std::string& target : targets) {
    std::string counted = "–";
    for (const RowResult& row : table.rows)
      if (row.target == target && row.counts)
        counted = fmt::format("{} in {}", row.counts->vehicles, row.counts->frames);
    text += " " + counted + " |";
  }
  text += "\n\n";
  for (const RowResult& row : table.rows)
    for (const std::string& remark : {row.note, row.error})
      if (!remark.empty()) text += fmt::format("- {}: {}\n", row.label, remark);
  return text + "\n";
}

}  // namespace mirage::paper
