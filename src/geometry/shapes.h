// Simple meshes: the adversary's start and the building blocks of proxies and generated scenes.
#pragma once

#include "geometry/mesh.h"

namespace mirage {

/// Unit sphere from an icosahedron whose faces are split `subdivisions` times into four:
/// 10·4^n + 2 vertices and 20·4^n faces (n = 2: 162 and 320, the adversary's).
Mesh icosphere(int subdivisions);
/// Half lengths (m) of the box that an object on a roof may fill (Tu et al., CoRL 2021).
inline const Vec3d kRoofBox(0.8, 0.8, 0.5);
/// m, the longest of an object's measures: what is smaller or larger stands on no car's roof.
inline constexpr double kSmallestObject = 0.01, kLargestObject = 10;
/// icosphere(2) stretched to `share` of these half lengths (m), 5×5 mid-grey texels a face: where an attack
/// starts, and what tells how much of an object each host would show.
TexturedMesh grey_ellipsoid(const Vec3d& half_lengths, double share = 1);
/// Axis-aligned box of the given full sizes, centred at the origin: 8 vertices, 12 faces.
Mesh box_mesh(const Vec3d& size);
/// Appends `part`, transformed, to `mesh`.
void append(Mesh& mesh, const Mesh& part, const Transform& mesh_from_part);

}  // namespace mirage
