#include <csignal>
#include <cstdlib>

#include "base/error.h"
#include "base/memory.h"
#include "base/quiet_png.h"
#include "base/ranks.h"
#include "cli/command.h"

int main(int argc, char** argv) {
  // The Python of worker and reports may lie in a folder that a package manager owns.
  setenv("PYTHONDONTWRITEBYTECODE", "1", 0);
  // A file over the limit on sizes (ulimit -f): the write is to fail with EFBIG, which gets its line.
  std::signal(SIGXFSZ, SIG_IGN);
  mirage::join_ranks(argc, argv);
  // An attack, of which half is its clean frames' feature maps, peaks a quarter lower with it and is 7 %
  // slower.
  mirage::keep_heap_below(mirage::machine_memory() / mirage::ranks_here() / 10);
  mirage::watch_for_interrupt();
  mirage::silence_libpng();
  return mirage::leave_ranks(mirage::cli::dispatch({argv + 1, argv + argc}));
}
