// What of the object hides: its shape, its texture, or no more than its size. Each part is learned alone
// while the rest stays the paper's start (`--parts`), through each sensor of `fusion`, and judged net of a
// random mesh of the extents that came out. Not in the paper, which learns shape and texture together (Tu et
// al., CoRL 2021, section 3).
//
// Two arms are controls. `size` moves three half lengths and nothing else: what it reaches, a mesh need not
// learn. Through LiDAR no gradient reaches a texel, so that the attack through LiDAR is the one on shape
// there.
#pragma once

#include <string>
#include <vector>

#include "validation/paper/case_list.h"

namespace mirage::paper {

/// One arm: through which sensor ("image", "lidar", "both"), and what is learned (a word of --parts; empty:
/// shape and texture).
struct PartArm {
  std::string target, parts;
  std::string run() const { return run_name("kitti64", "fusion", target, {.parts = parts}); }
};

/// Every arm, through each sensor the whole object first.
const std::vector<PartArm>& part_arms();

/// Learned and judged on the KITTI rig.
Table parts_table(CaseList& list);

}  // namespace mirage::paper
