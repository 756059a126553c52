// Errors that reach the user. InputError: something the user gave is wrong (exit code 2). Failure: the work
// could not be done though the input was right (exit code 1). Both carry one line: the file or option, the
// field in it, and the fix. It stays one line whatever it quotes: control characters and bytes that are not
// UTF-8 appear as "\xHH", and long texts are cut.
#pragma once

#include <stdexcept>
#include <string>

namespace mirage {

/// The user's input is to blame: file, field and fix in one line. The program exits with 2.
class InputError : public std::runtime_error {
 public:
  /// `where`: file or option; `field`: row, byte, key…; `problem`: what is wrong; `fix`: what to do.
  InputError(const std::string& where, const std::string& field, const std::string& problem,
             const std::string& fix);
};

/// The world is to blame (a full disk, a child that dies): place, problem and fix in one line. Exit code 1.
class Failure : public std::runtime_error {
 public:
  /// The line is "where: problem; fix".
  Failure(const std::string& where, const std::string& problem, const std::string& fix);
};

/// Thrown at the next safe point after Ctrl-C, once finished work is on disk. The text says what was kept.
class Interrupted : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// Ctrl-C and SIGTERM set a flag; long loops check it between units of work.

/// Installs the handlers. A second signal ends the process at once.
void watch_for_interrupt();
/// True once a signal has come.
bool interrupted();
/// Throws Interrupted with a text that says that `kept` is safe, if a signal has come.
void throw_if_interrupted(const char* kept);

// The same for a host program with its own signal handlers (Python).

/// As watch_for_interrupt(), for Ctrl-C alone and while the object lives. Its destructor restores the host's
/// handler and clears the flag. A second Ctrl-C goes to the host. Only one may exist at a time.
class InterruptWatch {
 public:
  InterruptWatch();
  ~InterruptWatch();
  InterruptWatch(const InterruptWatch&) = delete;
  InterruptWatch& operator=(const InterruptWatch&) = delete;
};

}  // namespace mirage
