#include <csignal>
#include <cstdlib>

#include "base/error.h"
#include "base/ranks.h"
#include "cli/command.h"

int main(int argc, char** argv) {
  // The Python of worker and reports may lie in a folder that a package manager owns.
  setenv("PYTHONDONTWRITEBYTECODE", "1", 0);
  // A file over the limit on sizes (ulimit -f): the write is to fail with EFBIG, which gets its line.
  std::signal(SIGXFSZ, SIG_IGN);
  mirage::join_ranks(argc, argv);
  mirage::watch_for_interrupt();
  return mirage::leave_ranks(mirage::cli::dispatch({argv + 1, argv + argc}));
}
