#include "base/field_json.h"

#include <climits>

#include "base/names.h"

namespace mirage {

namespace fs = std::filesystem;

std::string written_path(const fs::path& path, const char* word) {
  return path.empty() || path == word ? path.string()
                                      : escape_name(fs::absolute(path).lexically_normal().string());
}

std::string written_text(const std::string& text) {
  return escape_name(text);
}

void complete(nlohmann::json& written, const nlohmann::json& lacking) {
  for (const auto& [name, value] : lacking.items())
    if (!written.contains(name))
      written[name] = value;
    else if (value.is_object() && written[name].is_object())
      complete(written[name], value);
    else if (value.is_array() && written[name].is_array())
      for (std::size_t i = written[name].size(); i < value.size(); ++i) written[name].push_back(value[i]);
}

std::string read_text(const JsonFields& json, const char* name) {
  std::string text = unescape_name(json.text(name));
  for (const auto& part : fs::path(text))
    if (part.native().size() > NAME_MAX || text.size() >= PATH_MAX) json.fail(name, "is too long for a path");
  return text;
}

}  // namespace mirage
