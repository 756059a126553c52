#include "base/shared_library.h"

#include <dlfcn.h>

namespace mirage {

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
