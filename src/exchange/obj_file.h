// Wavefront OBJ ("Object Files (.obj)", Alias Wavefront's Advanced Visualizer 3.0, appendix B1): out, for
// programs that read neither glTF nor FBX, and its polygons in.
#pragma once

#include <filesystem>

#include "exchange/polygons.h"
#include "geometry/mesh.h"

namespace mirage {

/// The mesh as other programs place it: moved down or up so that its lowest vertex lies at z = 0. Its origin
/// is then the point that is set on a vehicle's roof (place(), simulation/insertion.h), and the pivot there.
TexturedMesh standing_on_origin(TexturedMesh adversary);

/// Writes FILE.obj, FILE.mtl and FILE.png (8-bit sRGB, a pixel a texel), each atomically: metres, x forward,
/// y left, z up, one object of one material. Each face is cut into its C² congruent triangles with all UVs at
/// one texel's centre, as in glTF (exchange/gltf.h), so that any filter shows the exact texel; without texels
/// it is whole and grey. Vertices are shared between triangles, with 9 digits. InputError if `file` does not
/// end in .obj, however that is spelt.
void write_obj(const std::filesystem::path& file, const TexturedMesh& textured);

/// The vertices (v) and polygons (f, by absolute or relative numbers) of a file; texture, normals, groups,
/// materials, lines and curves are read over, and no file that it names is opened. InputError naming the line
/// for a vertex without three finite numbers, a corner that is no number, and either of more than a megabyte;
/// else as Polygons. For read_polygons.
void read_obj(FileCharacters& from, Polygons& into);

}  // namespace mirage
