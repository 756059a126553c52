#include "base/interrupt.h"
#include "cli/dispatch.h"

int main(int argc, char** argv) {
  mirage::watch_for_interrupt();
  return mirage::cli::dispatch({argv + 1, argv + argc});
}
