#include "base/provenance.h"

#include <fstream>

#include "base/files.h"

namespace mirage {
namespace {

// Version and commit are by src/CMakeLists.txt. The commit has a place of its own, which program_identity()
// leaves out: the same program built from another commit is the same.
constexpr std::size_t kMark = 14, kPlace = 64;  // bytes of what marks the place, and of all of it
volatile const char commit_place[kPlace] = "mirage-commit:" MIRAGE_COMMIT;

}  // namespace

std::string program_version() {
  return MIRAGE_VERSION;
}

std::string program_commit() {
  std::string text;
  for (std::size_t i = kMark; i < kPlace && commit_place[i] != 0; ++i) text += commit_place[i];
  return text;
}

std::string program_identity(const std::filesystem::path& file) {
  std::string program = read_file(file);
  std::string place;
  for (const volatile char& c : commit_place) place += c;
  for (std::size_t at = 0; (at = program.find(place, at)) != std::string::npos; at += kPlace)
    program.replace(at, kPlace, kPlace, '-');
  std::ifstream processor("/proc/cpuinfo");
  std::string line;
  while (std::getline(processor, line) && line.rfind("flags", 0) != 0 && line.rfind("Features", 0) != 0) {
  }
  return content_hash(program) + " " + content_hash(line);
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
