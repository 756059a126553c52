#include "base/interrupt.h"
#include "base/quiet_png.h"
#include "base/ranks.h"
#include "cli/dispatch.h"

int main(int argc, char** argv) {
  mirage::join_ranks(argc, argv);
  mirage::watch_for_interrupt();
  mirage::silence_libpng();
  return mirage::leave_ranks(mirage::cli::dispatch({argv + 1, argv + argc}));
}
