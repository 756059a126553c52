// Objects that an evaluation puts on roofs without learning them: the user's files, and the zoo, the objects
// shipped in scenes/objects (zoo.json there gives their origins).
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "attack/run.h"
#include "base/provenance.h"
#include "geometry/mesh.h"

namespace mirage {

/// The word for all shipped objects.
inline constexpr const char* kZoo = "zoo";

/// An object with its origin on the roof.
struct NamedObject {
  std::string name;            ///< "kayak" for a shipped object, otherwise the file as requested
  std::filesystem::path file;  ///< file that was read
  TexturedMesh mesh;
};

/// Reads each file by read_object (exchange/mesh_files.h); kZoo stands for every shipped object, by name.
/// FieldError of "mesh" for a repeated object, or if no objects are shipped; errors as read_object.
std::vector<NamedObject> read_objects(const std::vector<std::filesystem::path>& words);

/// Adds the objects' names and mesh contents as "mesh".
void add_objects(Provenance& provenance, const std::vector<NamedObject>& objects);

/// The mesh with `resolution`² texels a face, each the mean of its area (64 samples).
TexturedMesh resampled(const TexturedMesh& mesh, int resolution);

/// An everyday roof load as an object, always the same. (Loads of generated cars are random:
/// generator/car.cpp.)
struct CarriedLoad {
  const char* name;  ///< "roof-box"
  const char* what;
  void (*add_to)(TexturedMesh& load);  ///< adds the load's parts to an empty mesh
};
/// A roof box, a ladder, a mattress, a kayak, and boxes under a net.
const std::vector<CarriedLoad>& carried_loads();
/// The load of that name, x along the car, y left, z up (m), standing at z = 0 around the origin: closed
/// parts, one texel a face. InputError for an unknown name.
TexturedMesh carried_load(const std::string& name);

/// A run with nothing but the objects: its adversary is the first, and its box is the smallest that contains
/// all objects and the default box.
Run run_of_objects(const std::vector<NamedObject>& objects);

}  // namespace mirage
