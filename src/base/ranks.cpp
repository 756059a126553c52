#include "base/ranks.h"

// Without MPI's former C++ interface, whose library is not linked.
#define OMPI_SKIP_MPICXX 1
#define MPICH_SKIP_MPICXX 1
#include <mpi.h>

#include <cstdio>
#include <cstdlib>

#include "base/random.h"
#include "base/sizes.h"

namespace mirage {
namespace {

int own_rank = 0, ranks = 1, on_this_machine = 1;
int alone = 0;  // number of living SingleRankScope
bool has_joined = false;

/// Whether a launcher started this process, by variables of Open MPI or PMI (MPICH, Slurm).
bool launched() {
  for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMI_RANK", "PMIX_RANK"})
    if (std::getenv(name) != nullptr) return true;
  return false;
}

}  // namespace

void join_ranks(int& argc, char**& argv) {
  if (!launched()) return;
  int provided = 0;
  MPI_Init_thread(&argc, &argv, MPI_THREAD_FUNNELED, &provided);
  MPI_Comm_rank(MPI_COMM_WORLD, &own_rank);
  MPI_Comm_size(MPI_COMM_WORLD, &ranks);
  MPI_Comm here;
  MPI_Comm_split_type(MPI_COMM_WORLD, MPI_COMM_TYPE_SHARED, 0, MPI_INFO_NULL, &here);
  MPI_Comm_size(here, &on_this_machine);
  MPI_Comm_free(&here);
  has_joined = true;
  if (own_rank > 0 && std::freopen("/dev/null", "w", stdout) == nullptr) std::perror("/dev/null");
}

int leave_ranks(int code) {
  if (!has_joined) return code;
  if (code != 0 && ranks > 1) MPI_Abort(MPI_COMM_WORLD, code);
  MPI_Finalize();
  has_joined = false;
  return code;
}

int rank() {
  return alone > 0 ? 0 : own_rank;
}

int rank_count() {
  return alone > 0 ? 1 : ranks;
}

std::size_t ranks_here() {
  return as_size(on_this_machine);
}

SingleRankScope::SingleRankScope() {
  ++alone;
}

SingleRankScope::~SingleRankScope() {
  --alone;
}

void await_ranks() {
  if (rank_count() > 1) MPI_Barrier(MPI_COMM_WORLD);
}

struct Arrival::Request {
  MPI_Request of = MPI_REQUEST_NULL;
};

Arrival::Arrival() {
  if (rank_count() == 1) return;
  request_ = std::make_unique<Request>();
  MPI_Ibarrier(MPI_COMM_WORLD, &request_->of);
}

Arrival::~Arrival() {
  if (request_) MPI_Wait(&request_->of, MPI_STATUS_IGNORE);
}

bool Arrival::all_here() {
  if (!request_) return true;
  int all = 0;
  MPI_Test(&request_->of, &all, MPI_STATUS_IGNORE);
  return all != 0;
}

bool any_rank(bool value) {
  if (rank_count() == 1) return value;
  int mine = value ? 1 : 0, all = 0;
  MPI_Allreduce(&mine, &all, 1, MPI_INT, MPI_LOR, MPI_COMM_WORLD);
  return all != 0;
}

void share_blocks(std::vector<std::vector<double>>& blocks) {
  if (rank_count() == 1) return;
  for (std::size_t k = 0; k < blocks.size(); ++k)
    MPI_Bcast(blocks[k].data(), static_cast<int>(blocks[k].size()), MPI_DOUBLE,
              static_cast<int>(k % as_size(ranks)), MPI_COMM_WORLD);
}

std::vector<std::size_t> order_among_ranks(std::size_t count,
                                           const std::function<bool(std::size_t)>& goes_on) {
  const auto first = [&](int r) { return count * as_size(r) / as_size(rank_count()); };
  std::vector<std::vector<std::size_t>> own, others;  // runs that stay together
  auto* part = &own;
  for (std::size_t i = 0; i < count; ++i) {
    if (i == 0 || !goes_on || !goes_on(i)) {
      part = i >= first(rank()) && i < first(rank() + 1) ? &own : &others;
      part->emplace_back();
    }
    part->back().push_back(i);
  }
  RandomStream random(static_cast<std::uint64_t>(rank()), "order among ranks");
  shuffle(others, random);
  own.insert(own.end(), others.begin(), others.end());
  std::vector<std::size_t> order;
  for (const auto& run : own) order.insert(order.end(), run.begin(), run.end());
  return order;
}

long first_rank_value(long value) {
  if (rank_count() > 1) MPI_Bcast(&value, 1, MPI_LONG, 0, MPI_COMM_WORLD);
  return value;
}

}  // namespace mirage
