// An iteration's hosts, spread over the processes of a run.
#pragma once

#include <vector>

#include "attack/host_step.h"

namespace mirage {

/// Of the hosts 0 … n − 1 of a batch those of this rank: every rank_count()-th, from its own number on.
std::vector<std::size_t> own_hosts(std::size_t n);

/// Gives every rank the steps that the others computed: then each sums all of them in the batch's order, to
/// the same bits as one process. `adversary` tells how long gradients are. A call of all ranks.
void share_steps(std::vector<HostStep>& steps, const TexturedMesh& adversary);

}  // namespace mirage
