#include "base/provenance.h"

#include <fstream>

#include "base/files.h"

namespace mirage {

std::string program_version() {
  return MIRAGE_VERSION;
}

std::string program_commit() {
  // Once: a build may write it anew while this program runs.
  static const std::string commit = [] {
    const std::filesystem::path file = built_file("mirage.commit");
    const std::string text = std::filesystem::exists(file) ? read_text(file, kMaxRecordBytes) : "";
    return text.substr(0, text.find('\n'));
  }();
  return commit;
}

std::string program_identity(const std::filesystem::path& file) {
  const std::filesystem::path pictures = built_file("plugins/pictures.so");
  const std::string decodes = std::filesystem::exists(pictures) ? file_hash(pictures) : "";
  std::ifstream processor("/proc/cpuinfo");
  std::string line;
  while (std::getline(processor, line) && line.rfind("flags", 0) != 0 && line.rfind("Features", 0) != 0) {
  }
  return file_hash(file) + " " + decodes + " " + content_hash(line);
}

std::string program_identity() {
  static const std::string identity = program_identity(program_file());
  return identity;
}

void Provenance::file(const std::string& name, const std::filesystem::path& path) {
  input(name, file_hash(path));
}

nlohmann::json Provenance::provenance() const {
  return {{"program", program_identity()}, {"inputs", inputs_}, {"settings", settings_}};
}

std::string Provenance::identity() const {
  return content_hash(provenance().dump());
}

nlohmann::json Provenance::json() const {
  nlohmann::json all = provenance();
  all.update({{"version", program_version()}, {"commit", program_commit()}, {"identity", identity()}});
  all.update(records_);
  return all;
}

}  // namespace mirage
