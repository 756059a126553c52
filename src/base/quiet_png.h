// libpng's line on standard error.
#pragma once

namespace mirage {

/// From now on libpng's readers in this program keep silent about damaged files: the reader's own error is
/// told once, in Mirage's line. (libpng prints when an error handler returns, and OpenImageIO's returns.)
void silence_libpng();

}  // namespace mirage
