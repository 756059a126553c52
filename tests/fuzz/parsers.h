// Every parser of files that the program takes from others, as a function of bytes, for the fuzzer and for
// the replay of what it found.
#pragma once

#include <filesystem>
#include <span>
#include <string>
#include <string_view>

namespace mirage::fuzz {

struct Parser {
  const char* name;
  const char* file;  ///< where the bytes are while they are read: parsers go by extensions and folders
  /// Reads the file and looks at what came out: std::logic_error for what no parser may hand on (numbers that
  /// are not finite, indices past their end, sizes that no machine holds).
  void (*read)(const std::filesystem::path& file);
};

std::span<const Parser> parsers();
/// std::invalid_argument, naming those there are, for another word.
const Parser& parser_named(const std::string& name);

/// Puts the bytes into a file of this process's own folder and reads it. The line with which they were
/// refused; empty if they were taken. Every other exception than InputError goes through, and a refusal of
/// more than one line, or of 2000 characters more than the file has, is a std::logic_error.
std::string read_bytes(const Parser& parser, std::string_view bytes);

/// This process's folder for files, in memory where the machine has such; gone when the process ends.
const std::filesystem::path& scratch();

/// std::logic_error if not.
void demand(bool good, const char* what);

}  // namespace mirage::fuzz
