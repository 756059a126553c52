// Meshes of other programs: a folder of vehicles in (glTF and OBJ by assimp, PLY by ply_file.h), single
// meshes out (glb, PLY).
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "scene/shape/shape_model.h"

namespace mirage {

/// Which of a file's axes point forward and up, each "+x", "-x", "+y", "-y", "+z" or "-z".
struct MeshAxes {
  std::string forward, up;
};

/// The mesh of a .glb, .gltf, .obj or .ply file in the vehicle's frame (x forward, y left, z up): all of its
/// nodes placed and joined, polygons cut into triangles, lines and points left out. Without `axes`, glTF has
/// +z forward and +y up (glTF 2.0, section 3.4); OBJ and PLY, which say nothing, +x forward and +z up.
/// Files that it names (a glTF's buffers, an OBJ's materials) are read from its own folder only
/// (FolderFiles). InputError naming file and fix if it can't be read, holds no faces or vertices beyond
/// gltf_limits::kFurthest, is a glTF that open_gltf refuses, or `axes` are no axes or parallel. Interrupted
/// after Ctrl-C.
Mesh read_mesh(const std::filesystem::path& file, const std::optional<MeshAxes>& axes = {});

/// The same with the colours of the materials' pictures: one texel a face (an atlas of resolution 1), where
/// the middle of the face's UVs lies in its material's base colour picture beside the file; a material's
/// plain colour without one; grey (0.5) without a material, as in a PLY.
TexturedMesh read_textured_mesh(const std::filesystem::path& file, const std::optional<MeshAxes>& axes = {});

/// Every such file of a folder, by name, as vehicles to learn from. They must be in metres and lie along x:
/// InputError, naming the file and its measures, unless the length is 2 to 12 m, the width 1 to 3.5 m, the
/// height 0.8 to 4.5 m and the length above the width. They needn't be watertight: inside is where the
/// generalised winding number is above one half (mesh_distance.h), so faces must be wound alike.
std::vector<ShapeSample> read_vehicle_meshes(const std::filesystem::path& folder,
                                             const std::optional<MeshAxes>& axes = {});

/// Writes a mesh in `velo` or a vehicle's frame: .glb (turned to y up) or .ply (binary, axes kept).
/// InputError for another extension.
void write_mesh(const std::filesystem::path& file, const Mesh& mesh);

}  // namespace mirage
