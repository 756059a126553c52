#include "validation/reference/reference_renderer.h"

namespace mirage {

void ReferenceIdentity::add_to(Provenance& made_of) const {
  for (const std::filesystem::path& program : programs) made_of.file(program.filename(), program);
  made_of.input(key, version);
}

}  // namespace mirage
