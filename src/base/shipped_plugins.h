// Plugins that ship with the program, by the words that ask for them. Beside plugins/NAME.so lies NAME.json:
//   {"kind": "detector" or "depth", "words": ["lidar", …], "weights": "data" or "code"}
// "code": what a weights file holds may run when it is loaded, so only the command line may name one.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace mirage {

struct ShippedPlugin {
  std::filesystem::path file;  ///< of the shared library
  std::vector<std::string> words;
  bool weights_are_code = true;
};

/// Those of a kind, by their files' names; none where they are not built. Looked for once. InputError naming
/// file and field of a description that is none.
const std::vector<ShippedPlugin>& shipped_plugins(const std::string& kind);
/// The one that the word asks for; null if none does.
const ShippedPlugin* shipped_plugin(const std::string& kind, const std::string& word);
/// "lidar, camera, …": the words of a kind, for messages.
std::string shipped_words(const std::string& kind);
/// The descriptions in a folder, of any kind; `kind` chooses.
std::vector<ShippedPlugin> read_shipped_plugins(const std::filesystem::path& folder, const std::string& kind);

}  // namespace mirage
