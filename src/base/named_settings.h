// The options of a command as a program gives them: by name, in the place of a command line.
#pragma once

#include <map>
#include <string>

namespace mirage {

/// Texts by name: texel_rate for --texel-rate; a flag's is true or false.
using NamedSettings = std::map<std::string, std::string>;

}  // namespace mirage
