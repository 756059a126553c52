// A plugin with one error, chosen by FAKE at compile time (tests/plugins.cmake): code shared by the fakes of
// detectors and of depth completion.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <stdexcept>

namespace mirage::test {

/// In the order of the names in tests/plugins.cmake.
enum class Fake {
  works,
  wrong_abi,
  refuses,
  throws_in_create,
  throws_in_run,
  fails_in_run,
  not_finite,
  no_entry
};
inline constexpr Fake kFake = static_cast<Fake>(FAKE);

inline int fake_instance = 0;

inline void* create(const char*, const char*, char* error, std::size_t error_size) {
  if (kFake == Fake::throws_in_create) throw std::runtime_error("thrown on purpose");
  if (kFake == Fake::refuses) {
    std::snprintf(error, error_size, "these weights are for another network");
    return nullptr;
  }
  return &fake_instance;
}
inline void destroy(void*) {}

/// The start of each run: throws, or returns nonzero if it should fail.
inline int begin_run(char* error, std::size_t error_size) {
  if (kFake == Fake::throws_in_run) throw std::runtime_error("thrown on purpose");
  if (kFake != Fake::fails_in_run) return 0;
  std::snprintf(error, error_size, "out of luck");
  return 1;
}

template <class Sample>
int train_step(void*, const Sample*, std::int64_t, float, float loss[3], char*, std::size_t) {
  loss[0] = loss[1] = loss[2] = 1;
  return 0;
}
inline int save(void*, const char*, std::int32_t, char*, std::size_t) {
  return 0;
}

inline std::uint32_t abi(std::uint32_t right) {
  return kFake == Fake::wrong_abi ? 999u : right;
}

}  // namespace mirage::test

/// The entry point's name: another one if it should be missing.
#if FAKE == 7
#define MIRAGE_FAKE_ENTRY(name) some_other_function
#else
#define MIRAGE_FAKE_ENTRY(name) name
#endif
