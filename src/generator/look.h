// What kind of place the generated streets show.
#pragma once

#include <string>

#include "base/error.h"
#include "base/words.h"

namespace mirage {

/// Which country's streets are generated.
enum class Look {
  european,  ///< streets of a middle-sized German town and the roads around it
  american   ///< North American avenues, suburbs and office blocks
};

/// "european", "american".
inline std::string name_of(Look look) {
  return look == Look::american ? "american" : "european";
}

/// InputError naming `where` and `field` if there is no such look.
inline Look parse_look(const std::string& name, const std::string& where, const std::string& field) {
  if (name == "european") return Look::european;
  if (name == "american") return Look::american;
  throw InputError(where, field, name + " is not a look", use_one_of(name, {"european", "american"}));
}

}  // namespace mirage
