// Plugins that ship with the program, by the words that ask for them. Beside plugins/NAME.so lies NAME.json:
//   {"kind": "detector", "depth" or "sensor", "words": ["lidar", …],
//    "weights": "data", "code" or "none"}
// "code": loading a weights file may run code from it, so only the command line may name one. "none": it
// needs no weights; the content of a file that is passed anyway is unknown.
#pragma once

#include <cstddef>
#include <cstdint>
#include <exception>
#include <filesystem>
#include <initializer_list>
#include <string>
#include <vector>

#include "base/error.h"

namespace mirage {

/// A plugin as the NAME.json beside it describes it.
struct ShippedPlugin {
  std::filesystem::path file;  ///< of the shared library
  std::vector<std::string> words;
  bool needs_weights = true, weights_are_code = true;
};

/// The plugins of a kind, sorted by file name; empty if they are not built. Searched once. InputError naming
/// file and field of an invalid description.
const std::vector<ShippedPlugin>& shipped_plugins(const std::string& kind);
/// The plugin that the word names; null without one.
const ShippedPlugin* shipped_plugin(const std::string& kind, const std::string& word);
/// Whether a word names a user's plugin: a path *.so.
inline bool is_plugin_path(const std::string& word) {
  return std::filesystem::path(word).extension() == ".so";
}
/// The plugins of `kind` that the descriptions in a folder list.
std::vector<ShippedPlugin> read_shipped_plugins(const std::filesystem::path& folder, const std::string& kind);

// Plugins: shared libraries that export one entry function, which returns a table of C functions. Every
// failure of a foreign library becomes one clear line.

/// Bytes that a plugin's function may write its reason to.
inline constexpr std::size_t kPluginErrorSize = 1024;

/// Runs plugin code: an exception that escapes it (none should) becomes a Failure.
template <class Work>
auto call_plugin(const std::filesystem::path& file, const std::string& function, const Work& work) {
  try {
    return work();
  } catch (const std::exception& problem) {
    throw Failure(file.string(), function + " threw an exception (" + problem.what() + ")",
                  "report it to the plugin's author");
  } catch (...) {
    throw Failure(file.string(), function + " threw an exception", "report it to the plugin's author");
  }
}

/// Runs work(error), which returns 0 or writes its reason to error: Failure naming file and function, or
/// InputError naming `weights` when it returns 2: the file that the user gave to the plugin is to blame.
template <class Work>
void run_plugin(const std::filesystem::path& file, const std::string& function, const Work& work,
                const std::filesystem::path& weights = {}) {
  char error[kPluginErrorSize] = "";
  const int status = call_plugin(file, function, [&] { return work(error); });
  if (status == 2 && !weights.empty())
    throw InputError(weights.string(), "", error[0] ? error : "no reason given", "check --weights");
  if (status != 0)
    throw Failure(file.string(), function + " failed (" + (error[0] ? error : "no reason given") + ")",
                  "check the input, the weights and the free memory");
}

/// The address of `entry` in the library. `contract` is the header that says what to export. InputError if
/// the file is not a library for this machine or lacks the entry. Never unloaded: LibTorch keeps threads and
/// statics that do not survive that.
void* plugin_symbol(const std::filesystem::path& file, const std::string& entry, const std::string& contract);

/// Opens a plugin whose entry returns a `const Api*` with an abi_version. InputError for a version that is
/// not among `versions`.
template <class Api>
const Api* open_plugin(const std::filesystem::path& file, const std::string& entry,
                       const std::string& contract, std::initializer_list<std::uint32_t> versions) {
  void* symbol = plugin_symbol(file, entry, contract);
  const Api* api = call_plugin(file, entry, [&] { return reinterpret_cast<const Api* (*)()>(symbol)(); });
  if (!api) throw InputError(file.string(), entry, "the entry point returned nothing", "rebuild the plugin");
  std::string supported;
  for (const std::uint32_t version : versions) {
    if (api->abi_version == version) return api;
    supported += (supported.empty() ? "" : " and ") + std::to_string(version);
  }
  throw InputError(file.string(), "abi_version",
                   "is " + std::to_string(api->abi_version) + ", this program speaks " + supported,
                   "rebuild the plugin against this version");
}

}  // namespace mirage
