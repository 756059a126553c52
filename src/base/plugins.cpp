#include "base/plugins.h"

#include <dlfcn.h>

#include <algorithm>
#include <map>
#include <mutex>

#include "base/files.h"
#include "base/json_fields.h"

namespace mirage {

namespace fs = std::filesystem;

std::vector<ShippedPlugin> read_shipped_plugins(const fs::path& folder, const std::string& kind) {
  std::vector<fs::path> files;
  std::error_code error;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error))
    if (entry->path().extension() == ".json") files.push_back(entry->path());
  std::sort(files.begin(), files.end());
  std::vector<ShippedPlugin> plugins;
  for (const fs::path& file : files) {
    const nlohmann::json json = read_json(file);
    const JsonFields about(file, json, "restore the file from the sources (plugin.json)");
    if (about.text("kind") != kind) continue;
    ShippedPlugin plugin;
    plugin.file = fs::path(file).replace_extension(".so");
    for (const nlohmann::json& word : about.list("words", 100)) {
      if (!word.is_string()) about.fail("words", "not a list of texts");
      plugin.words.push_back(word);
    }
    const std::string weights = about.text("weights");
    if (weights != "data" && weights != "code" && weights != "none")
      about.fail("weights", "neither data, code nor none");
    plugin.needs_weights = weights != "none";
    plugin.weights_are_code = weights != "data";
    plugins.push_back(std::move(plugin));
  }
  return plugins;
}

const std::vector<ShippedPlugin>& shipped_plugins(const std::string& kind) {
  static std::mutex mutex;
  static std::map<std::string, std::vector<ShippedPlugin>> shipped;
  const std::scoped_lock lock(mutex);
  const auto place = shipped.find(kind);
  if (place != shipped.end()) return place->second;
  return shipped[kind] = read_shipped_plugins(built_file("plugins"), kind);
}

const ShippedPlugin* shipped_plugin(const std::string& kind, const std::string& word) {
  for (const ShippedPlugin& plugin : shipped_plugins(kind))
    if (std::find(plugin.words.begin(), plugin.words.end(), word) != plugin.words.end()) return &plugin;
  return nullptr;
}

void* plugin_symbol(const std::filesystem::path& file, const std::string& entry,
                    const std::string& contract) {
  void* library = dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (!library) {
    const char* why = dlerror();
    throw InputError(file.string(), "", std::string("not a loadable plugin (") + (why ? why : "?") + ")",
                     "rebuild it for this machine");
  }
  void* symbol = dlsym(library, entry.c_str());
  if (!symbol)
    throw InputError(file.string(), entry, "the plugin lacks this entry point",
                     "export it as " + contract + " says");
  return symbol;
}

}  // namespace mirage
