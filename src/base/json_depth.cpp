#include "base/json_depth.h"

#include <fmt/format.h>

#include "base/error.h"

namespace mirage {

void check_json_depth(std::string_view text, const std::string& where, const std::string& field) {
  int depth = 0;
  bool quoted = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (quoted) {
      if (c == '\\') ++i;
      quoted = c != '"';
    } else if (c == '"') {
      quoted = true;
    } else if (c == '[' || c == '{') {
      if (++depth > kDeepestJson)
        throw InputError(where, field, fmt::format("byte {}: nested deeper than {} levels", i, kDeepestJson),
                         "write the file again with the program that made it");
    } else if (c == ']' || c == '}') {
      --depth;
    }
  }
}

}  // namespace mirage
