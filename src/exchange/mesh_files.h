// Wavefront OBJ ("Object Files (.obj)", Alias Wavefront's Advanced Visualizer 3.0, appendix B1): out, for
// programs that read neither glTF nor FBX, and its polygons in.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "exchange/polygons.h"
#include "geometry/mesh.h"
#include "scene/shape/shape_model.h"

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
/// materials, lines and curves are skipped, and no file that it names is opened. InputError naming the line
/// for a vertex without three finite numbers, a corner that is not a number, and a v or f row of more than a
/// megabyte; otherwise as Polygons. For read_polygons.
void read_obj(FileCharacters& from, Polygons& into);

// Meshes of other programs: single ones and a folder of vehicles in (glTF, OBJ, PLY), single ones out (glb,
// PLY).

/// Which of a file's axes point forward and up, each "+x", "-x", "+y", "-y", "+z" or "-z".
struct MeshAxes {
  std::string forward, up;
};

/// Reads a glTF (binary or text), OBJ or PLY file, told apart by content and not by name, as an object's
/// mesh: x forward, y left, z up, with texels. A glTF that Mirage wrote comes back bit for bit. Another glTF
/// is turned from y up, its faces have their base colour, and one warning names other sources of colour. OBJ
/// and PLY keep their axes, and are mid-grey with 5 × 5 texels a face. InputError and Interrupted as
/// read_mesh.
TexturedMesh read_textured_mesh(const std::filesystem::path& file);

/// The same for an object that stands on a vehicle's roof, with its origin there. Warns of an object larger
/// than a roof. InputError also for a scene of mirage export and as check_object (simulation/check_inputs.h).
TexturedMesh read_object(const std::filesystem::path& file);

/// Writes a mesh for read_textured_mesh. The file's ending, in any case, sets the format: .glb with every bit
/// of vertices and texels, .obj with texels of 8 bits (write_obj), .ply the shape alone. InputError for
/// another ending.
void write_textured_mesh(const std::filesystem::path& file, const TexturedMesh& mesh);

/// The shape of a glTF, OBJ or PLY file (by content) in the vehicle's frame (x forward, y left, z up): all of
/// its nodes placed, polygons cut into triangles, lines and points left out, coincident vertices merged.
/// Without `axes`, glTF has +z forward and +y up (glTF 2.0, section 3.4); OBJ and PLY, which say nothing, +x
/// forward and +z up. A glTF's buffers are read from its own folder only (ConfinedFiles), and an OBJ's
/// materials not at all. InputError naming file and fix if it can't be read, holds no faces or vertices
/// beyond gltf_limits::kMaxCoordinate, is a glTF that open_gltf refuses, or `axes` are no axes or parallel.
/// Interrupted after Ctrl-C.
Mesh read_mesh(const std::filesystem::path& file, const std::optional<MeshAxes>& axes = {});

/// Every mesh file of a folder, sorted by name, as vehicles to learn from. They must be in metres and lie
/// along x: InputError, naming the file and its measures, unless the length is 2 to 12 m, the width 1 to 3.5
/// m, the height 0.8 to 4.5 m and the length above the width. They needn't be watertight: inside is where the
/// generalised winding number is above one half (sensors/ray_caster.h), so faces must be wound alike.
std::vector<ShapeSample> read_vehicle_meshes(const std::filesystem::path& folder,
                                             const std::optional<MeshAxes>& axes = {});

/// Writes a mesh in `velo` or a vehicle's frame: .glb (turned to y up) or .ply (binary, axes kept).
/// InputError for another extension.
void write_mesh(const std::filesystem::path& file, const Mesh& mesh);

}  // namespace mirage
