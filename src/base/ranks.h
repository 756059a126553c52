// The processes of one run under `mpirun -n N mirage …` (MPI). Without a launcher there is one, and MPI is
// not even started. Ranks' data are concatenated in a fixed order, never summed on the way, so N processes
// compute the same bits as one.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <vector>

namespace mirage {

/// Starts MPI if a launcher started this process; once, at the head of main. Ranks but the first write
/// nothing to standard output.
void join_ranks(int& argc, char**& argv);
/// Ends MPI, at the end of main. A code other than 0 ends the other ranks too: one that waits for a failed
/// rank would wait for ever. Returns the code.
int leave_ranks(int code);

/// 0 for the first (or only) process, which alone writes files.
int rank();
/// How many processes there are.
int rank_count();

/// How many ranks run on this machine.
std::size_t ranks_here();

/// While it lives, this process counts as the only rank: its calls neither wait for other ranks nor send to
/// them. For ranks that do different work side by side.
class SingleRankScope {
 public:
  SingleRankScope();
  ~SingleRankScope();
  SingleRankScope(const SingleRankScope&) = delete;
  SingleRankScope& operator=(const SingleRankScope&) = delete;
};

/// A barrier: returns once all ranks call it; all then see the first's files. Collective: all ranks call it.
void await_ranks();
/// A non-blocking barrier: says that this rank has finished its part of a step and tells whether all have, so
/// that it may work ahead meanwhile. Collective; the destructor waits for every rank.
class Arrival {
 public:
  Arrival();
  ~Arrival();
  Arrival(const Arrival&) = delete;
  Arrival& operator=(const Arrival&) = delete;
  /// Whether every rank has arrived; does not wait.
  bool all_here();

 private:
  struct Request;
  std::unique_ptr<Request> request_;  ///< null: no other rank is left
};
/// True on every rank if `value` is true on any. Collective.
bool any_rank(bool value);
/// Block k belongs to rank k % rank_count(); afterwards every rank holds all blocks. All blocks have one
/// size, which every rank sets beforehand. Collective.
void share_blocks(std::vector<std::vector<double>>& blocks);
/// The order in which this process takes the items 0 … count − 1 when all ranks share one cache of results:
/// its own range first, then the rest in its own random order. So ranks finish together, whatever each item
/// costs, and a rank that dies leaves its items to the others. A single process keeps their order.
/// `goes_on(i)`: item i shares work with the one before (reading a frame); these runs stay together.
std::vector<std::size_t> order_among_ranks(std::size_t count,
                                           const std::function<bool(std::size_t)>& goes_on = {});
/// The first rank's value, on every rank. Collective.
long first_rank_value(long value);

}  // namespace mirage
