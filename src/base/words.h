// Words that name one thing of several (a command, an option, a rig, a defence …), and what is said of one
// that names none: which was meant, and all that there are.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "base/fields.h"

namespace mirage {

/// Fewest letters to insert, delete, replace or swap with a neighbour that make one word the other: the
/// Damerau–Levenshtein distance (optimal string alignment; Damerau, CACM 1964). Capitals count as small
/// letters, '_' as '-'.
int slips_between(std::string_view a, std::string_view b);

/// Those of `known` that `word` may have meant, nearest first: a third of the letters wrong at most, or one
/// begins with the other.
std::vector<std::string> meant_by(std::string_view word, const std::vector<std::string>& known);

/// "did you mean b? use b, a, c or FORMS", with those first that may be meant; "use a, b, c or FORMS" where
/// none may. `forms`: what else may stand there; empty: nothing.
std::string use_one_of(std::string_view word, const std::vector<std::string>& known,
                       const std::string& forms = "");

/// The error for a field's word that is none of `known`.
FieldError unknown_word(const std::string& field, const std::string& word,
                        const std::vector<std::string>& known, const std::string& forms = "");

/// Names of the files that ship in a folder such as "scenes/rigs", without their extension, sorted; none
/// where there is no such folder.
std::vector<std::string> shipped_names(const std::string& folder, const std::string& extension);

/// The shipped file of that name. FieldError of `field` that names all there are if it is none of them;
/// InputError as shipped_file() (base/files.h) where the folder itself is missing.
std::filesystem::path shipped_choice(const std::string& folder, const std::string& extension,
                                     const std::string& word, const std::string& field,
                                     const std::string& forms = "");

}  // namespace mirage
