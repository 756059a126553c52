#include "validation/paper/matrix_markdown.h"

#include <fmt/format.h>

#include <algorithm>
#include <vector>

#include "base/bootstrap.h"

namespace mirage::paper {
namespace {

using nlohmann::json;

/// The cell's row, if it has numbers.
const json* find(const json& table, const std::string& source, const std::string& target) {
  for (const json& row : table.at("rows"))
    if (row.at("source") == source && row.at("target") == target) return &row;
  return nullptr;
}

std::vector<std::string> each_once(const json& table, const char* key) {
  std::vector<std::string> names;
  for (const json& row : table.at("rows"))
    if (const auto name = row.at(key).get<std::string>();
        std::find(names.begin(), names.end(), name) == names.end())
      names.push_back(name);
  return names;
}

Interval interval_from(const json& value) {
  return {value.at("value"), value.at("low"), value.at("high")};
}

/// "8.6; +7.1 (+0.0 to +17.5)"
std::string cell_text(const json& values, const std::string& key) {
  if (!values.contains(key)) return "–";
  std::string text = fmt::format("{:.1f}", 100 * values.at(key).at("value").get<double>());
  if (!values.contains("net_" + key)) return text;
  const Interval net = interval_from(values.at("net_" + key));
  text += fmt::format("; {:+.1f} ({:+.1f} to {:+.1f})", 100 * net.value, 100 * net.low, 100 * net.high);
  for (std::size_t at; (at = text.find('-')) != std::string::npos;) text.replace(at, 1, "−");
  // A sign would say more of a zero than is known.
  for (const char* zero : {"+0.0", "−0.0"})
    for (std::size_t at; (at = text.find(zero)) != std::string::npos;)
      text.replace(at, std::string(zero).size(), "0.0");
  return text;
}

}  // namespace

std::string matrix_markdown(const json& table) {
  const auto sources = each_once(table, "source"), targets = each_once(table, "target");
  std::string text = fmt::format("## {}: {}\n\n{}\n\n", table.at("name").get<std::string>(),
                                 table.at("title").get<std::string>(), table.at("note").get<std::string>());
  std::string head = " |", rule = "|---|";
  for (const std::string& target : targets) head += " " + target + " |", rule += "---|";
  for (const json& column : table.at("columns")) {
    const auto key = column.at("key").get<std::string>(), title = column.at("title").get<std::string>();
    if (key.starts_with("net")) continue;
    text +=
        fmt::format("| {}, %{}{}\n{}\n", title, key == "fp_asr" ? "" : "; net, points (95 %)", head, rule);
    for (const std::string& source : sources) {
      text += "| " + source + " |";
      for (const std::string& target : targets) {
        const json* row = find(table, source, target);
        const std::string cell = row ? cell_text(row->at("values"), key) : "–";
        text += source.starts_with(target + ",") ? " **" + cell + "** |" : " " + cell + " |";
      }
      text += "\n";
    }
    text += "\n";
  }
  text += "| vehicles found clean at IoU 0.7 |" + head.substr(2) + "\n" + rule + "\n| in frames |";
  for (const std::string& target : targets) {
    std::string counted = "–";
    for (const json& row : table.at("rows"))
      if (row.at("target") == target && row.contains("vehicles"))
        counted = fmt::format("{} in {}", row.at("vehicles").get<int>(), row.at("frames").get<int>());
    text += " " + counted + " |";
  }
  text += "\n\n";
  for (const json& row : table.at("rows"))
    for (const char* key : {"note", "error"})
      if (row.contains(key))
        text += fmt::format("- {}: {}\n", row.at("label").get<std::string>(), row.at(key).get<std::string>());
  return text + "\n";
}

}  // namespace mirage::paper
