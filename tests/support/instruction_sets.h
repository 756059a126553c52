// Code that is compiled for several instruction sets.
#pragma once

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <cstdint>

namespace mirage {

/// Calls check() under each instruction set that this machine has.
template <class F>
void on_every_instruction_set(const F& check) {
  for (const std::int64_t set : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(set);
    SCOPED_TRACE(hwy::TargetName(set));
    check();
  }
  hwy::SetSupportedTargetsForTest(0);
}

}  // namespace mirage
