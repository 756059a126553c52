// Pages of commands: what a Python program makes from their result.json.
#pragma once

#include <filesystem>
#include <string>

#include "base/child_process.h"
#include "base/logging.h"

namespace mirage::cli {

/// Writes the page beside OUT/result.json, one self-contained file, by validation/report/command_page.py. A
/// warning in its place where Python or jinja2 is missing.
inline void write_page(const std::filesystem::path& out) {
  std::string said;
  if (run_script("validation/report/command_page.py", out, &said) != 0)
    spdlog::warn("no page beside {}: {}", (out / "result.json").string(),
                 said.empty() ? "install python3-jinja2 and python3-pil" : said);
}

}  // namespace mirage::cli
