// Instruction sets that Highway compiles our vectorised code for; include it before hwy/foreach_target.h.
#pragma once

#undef HWY_DISABLED_TARGETS
#ifdef __aarch64__
// GCC makes a struct's implicit constructor without the attributes of a set; NEON without AES needs none.
#define HWY_DISABLED_TARGETS (~(HWY_NEON_WITHOUT_AES | HWY_EMU128))
#else
// State is kept in arrays of vectors, which types without a fixed size do not allow.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#endif
