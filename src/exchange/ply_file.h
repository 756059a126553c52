// PLY files (Turk, "The PLY Polygon File Format", 1994): text and binary of both byte orders, any scalar
// types. By our own reader, because assimp's (5.2) ends the program, reads past the file's end or takes
// memory by what a damaged one claims.
#pragma once

#include "exchange/polygons.h"

namespace mirage {

/// The elements "vertex" (properties x, y, z) and "face" (list vertex_indices or vertex_index); others are
/// read over. InputError naming the field for a header that is none or claims more than the file holds, and a
/// body that ends too early; else as Polygons. For read_polygons.
void read_ply(FileCharacters& from, Polygons& into);

}  // namespace mirage
