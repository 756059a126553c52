// Common code of the plugins' C interfaces: no exception leaves a function, and its message fits one line.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "base/sizes.h"

namespace mirage {

/// The user's file is to blame; the text says what is wrong and how to mend it.
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

/// Runs work(). Returns 0; 2 for a BadFile; 1 for any other exception.
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

/// Returns answers that live on in the instance, in the form of a table's function.
template <class Answer>
void give(const std::vector<Answer>& answers, const Answer** first, std::int64_t* count) {
  *first = answers.data();
  *count = static_cast<std::int64_t>(answers.size());
}

/// Functions of a table for instances of type T, each by T's method of that name.
template <class T>
struct CFunctions {
  static T& of(void* instance) { return *static_cast<T*>(instance); }
  /// The instance that make() returns. Null if it throws.
  template <class Make>
  static void* made(char* error, std::size_t error_size, const Make& make) noexcept {
    std::unique_ptr<T> instance;
    guarded(error, error_size, [&] { instance = make(); });
    return instance.release();
  }
  static void destroy(void* instance) { delete &of(instance); }
  static auto capabilities(void* instance) { return of(instance).capabilities(); }
  static void* share(void* instance, char* error, std::size_t error_size) {
    return made(error, error_size, [&] { return of(instance).shared(); });
  }
  /// Of a detector's table of version 4; below that of version 3.
  template <class Pass, class Answer>
  static int forward(void* instance, const Pass* pass, const Answer** answers, std::int64_t* count,
                     char* error, std::size_t error_size) {
    return guarded(error, error_size, [&] { give(of(instance).forward(*pass), answers, count); });
  }
  template <class Input, class Answer>
  static int forward(void* instance, const Input* input, float score_threshold, std::int32_t keep_graph,
                     const Answer** answers, std::int64_t* count, char* error, std::size_t error_size) {
    return guarded(error, error_size, [&] {
      give(of(instance).forward(*input, score_threshold, keep_graph != 0), answers, count);
    });
  }
  static int backward(void* instance, const float* d_logits, std::int64_t count, float* d_image,
                      float* d_points, char* error, std::size_t error_size) {
    return guarded(error, error_size, [&] {
      of(instance).backward({d_logits, as_size(count)}, d_image, d_points);
    });
  }
  template <class Sample>
  static int train_step(void* instance, const Sample* samples, std::int64_t count, float learning_rate,
                        float loss[3], char* error, std::size_t error_size) {
    return guarded(error, error_size, [&] {
      const auto terms = of(instance).train_step({samples, as_size(count)}, learning_rate);
      std::copy(terms.begin(), terms.end(), loss);
    });
  }
  static int save(void* instance, const char* file, std::int32_t with_optimiser, char* error,
                  std::size_t error_size) {
    return guarded(error, error_size, [&] { of(instance).save(file, with_optimiser != 0); });
  }
};

}  // namespace mirage
