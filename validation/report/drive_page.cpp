#include "validation/report/drive_page.h"

#include "base/child_process.h"
#include "base/files.h"
#include "base/logging.h"

namespace mirage {

void write_drive_page(const std::filesystem::path& out) {
  const std::string python = plotting_python().string();
  if (python.empty() ||
      run_program({python, shipped_file("validation/report/drive.py").string(), out.string()}) != 0)
    spdlog::warn("no page: install python3-jinja2 (all figures are in {})", (out / "result.json").string());
}

}  // namespace mirage
