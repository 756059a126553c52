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
/// Ends it, at the end of main. A code other than 0 ends the other ranks too: one that waits for a failed
/// rank would wait for ever. Returns the code.
int leave_ranks(int code);

/// 0 for the first (or only) process, which alone writes files.
int rank();
/// How many processes there are.
int rank_count();

/// How many of them run on this machine.
std::size_t ranks_here();

/// While one lives, this process counts as the only one: what it calls neither waits for other ranks nor
/// sends them anything. For ranks that do different work side by side.
class SingleRankScope {
 public:
  SingleRankScope();
  ~SingleRankScope();
  SingleRankScope(const SingleRankScope&) = delete;
  SingleRankScope& operator=(const SingleRankScope&) = delete;
};

/// Returns once every rank has come here: what the first wrote before is there for all. A call of all ranks.
void await_ranks();
/// Says that this rank has done its part of a step, and tells whether all have: until then it may do what it
/// will need later. A call of all ranks, which ends (in the destructor) once every rank has come here.
class Arrival {
 public:
  Arrival();
  ~Arrival();
  Arrival(const Arrival&) = delete;
  Arrival& operator=(const Arrival&) = delete;
  /// Whether every rank has come here; it does not wait.
  bool all_here();

 private:
  struct Request;
  std::unique_ptr<Request> request_;  ///< null: no other rank is left
};
/// True on every rank if it is on one. A call of all ranks.
bool any_rank(bool value);
/// block k is rank k % rank_count()'s; afterwards every rank holds all. All blocks are of one size, which
/// every rank gives them beforehand. A call of all ranks.
void share_blocks(std::vector<std::vector<double>>& blocks);
/// 0 … count − 1 in the order in which this process takes work whose results all ranks keep in one cache: its
/// own stretch first, then the rest in a random order of its own. So ranks finish together, whatever each
/// item costs, and a rank that dies leaves its items to the others. One process: as they are.
/// `goes_on(i)`: item i shares work with the one before (a frame to be read); such runs stay together.
std::vector<std::size_t> order_among_ranks(std::size_t count,
                                           const std::function<bool(std::size_t)>& goes_on = {});
/// The first rank's value, on all. A call of all ranks.
long first_rank_value(long value);

}  // namespace mirage
