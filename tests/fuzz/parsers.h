// Every parser of foreign files, as a function of bytes, for the fuzzer and for the replay of its findings.
#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <string_view>

namespace mirage::fuzz {

struct Parser {
  const char* name;
  const char* file;  ///< the file's path while it is read: parsers go by extensions and folders
  /// Reads the file and checks the result: std::logic_error for values that no parser may pass on (numbers
  /// that are not finite, indices out of range, sizes too large for any machine).
  void (*read)(const std::filesystem::path& file);
};

std::span<const Parser> parsers();
/// Throws std::invalid_argument, with the existing names, for an unknown name.
const Parser& parser_named(const std::string& name);

/// Writes the bytes into a file of this process's own folder and reads it. Returns the one-line refusal;
/// empty if the file was accepted. Exceptions other than InputError pass through. A refusal of more than one
/// line, or more than 2000 characters longer than the file, is a std::logic_error.
std::string read_bytes(const Parser& parser, std::string_view bytes);

/// This process's folder for files, in memory if the machine supports it; removed when the process ends.
const std::filesystem::path& scratch();

/// Throws std::logic_error if not `good`.
void demand(bool good, const char* what);

}  // namespace mirage::fuzz
