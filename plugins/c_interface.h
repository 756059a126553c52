// What every plugin's C interface needs: no exception leaves a function, and its reason fits one line.
#pragma once

#include <cstdio>
#include <exception>
#include <stdexcept>
#include <string>

namespace mirage {

/// The user's file is to blame; its text says what and how to mend it.
class BadFile : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

[[noreturn]] inline void bad(const std::string& field, const std::string& problem, const std::string& fix) {
  throw BadFile(field + ": " + problem + "; " + fix);
}

/// The first line: LibTorch appends a stack trace to its messages.
inline void report(const std::string& what, char* error, std::size_t error_size) {
  if (error && error_size > 0)
    std::snprintf(error, error_size, "%s", what.substr(0, what.find('\n')).c_str());
}

/// Runs work(). 0; 2 for a BadFile; 1 for anything else that is thrown.
template <class Work>
int guarded(char* error, std::size_t error_size, const Work& work) noexcept {
  try {
    work();
    return 0;
  } catch (const BadFile& problem) {
    report(problem.what(), error, error_size);
    return 2;
  } catch (const std::exception& problem) {
    report(problem.what(), error, error_size);
  } catch (...) {
    report("unknown error in the plugin", error, error_size);
  }
  return 1;
}

}  // namespace mirage
