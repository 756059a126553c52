// What a detector's convolutions are computed in (--precision).
#pragma once

#include <string>

namespace mirage {

inline constexpr const char* kFloat = "float";
inline constexpr const char* kBfloat16 = "bfloat16";
/// The whole network in double: a reference for the others, many times slower.
inline constexpr const char* kDouble = "double";

/// Whether this processor multiplies bfloat16 (AVX-512 BF16, which AMX comes on top of).
bool multiplies_bfloat16();

/// FieldError for a word that is no precision.
void check_precision(const std::string& word);

/// `asked`, or "float" where the processor has no instructions for bfloat16: elsewhere they are emulated,
/// slower than float. Says so, once. Errors as
/// check_precision's.
std::string usable_precision(const std::string& asked, bool has_bfloat16 = multiplies_bfloat16());

}  // namespace mirage
