// The short table that every command prints on standard output.
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

#include "base/names.h"

namespace mirage::cli {

using Rows = std::vector<std::pair<std::string, std::string>>;

inline void print_table(const Rows& rows) {
  std::size_t widest = 0;
  for (const auto& [name, value] : rows) widest = std::max(widest, name.size());
  for (const auto& [name, value] : rows)
    std::fputs(fmt::format("{:<{}}  {}\n", name, widest, printable(value)).c_str(), stdout);
  std::fflush(stdout);
}

inline std::string percent(double share) {
  return fmt::format("{:.1f} %", 100 * share);
}

/// "20.8 % (8.3–37.5)"
inline std::string percent(double share, double low, double high) {
  return fmt::format("{} ({:.1f}–{:.1f})", percent(share), 100 * low, 100 * high);
}

}  // namespace mirage::cli
