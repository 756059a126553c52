// PLY files (Turk, "The PLY Polygon File Format", 1994): text and binary of both byte orders, any scalar
// types. By our own reader, because assimp's (5.2) ends the program, reads past the file's end or takes
// memory by what a damaged one claims.
#pragma once

#include <string>
#include <string_view>

#include "exchange/polygons.h"

namespace mirage {

/// The elements "vertex" (properties x, y, z) and "face" (list vertex_indices or vertex_index); others are
/// read over. InputError naming `where` and the field for a header that is none or claims more than the bytes
/// hold, a body that ends too early, faces of less than one or more than kMostCorners corners, indices beyond
/// the vertices.
Polygons parse_ply(std::string_view bytes, const std::string& where);

}  // namespace mirage
