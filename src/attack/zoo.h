// Objects that an evaluation puts on roofs without having learned them: files of the user's, and the zoo,
// which is what ships in scenes/objects (zoo.json there tells where each comes from).
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "attack/run.h"
#include "base/provenance.h"
#include "geometry/mesh.h"

namespace mirage {

/// Stands for all objects that ship.
inline constexpr const char* kZoo = "zoo";

/// An object with its origin on the roof.
struct NamedObject {
  std::string name;            ///< of a shipped one "kayak"; else the file as it was asked for
  std::filesystem::path file;  ///< where it was read
  TexturedMesh mesh;
};

/// Each file as read_object (exchange/mesh_files.h) reads it; kZoo is every shipped object, by name.
/// FieldError of "mesh" for an object that is named twice, or where none ship; errors as read_object's.
std::vector<NamedObject> read_objects(const std::vector<std::filesystem::path>& words);

/// Their names and meshes as "mesh".
void add_objects(Provenance& provenance, const std::vector<NamedObject>& objects);

/// The mesh with `resolution`² texels a face, each the mean of what it covers (64 samples).
TexturedMesh resampled(const TexturedMesh& mesh, int resolution);

/// A load that people carry on their roofs, as an object, always the same. (Those of generated cars are
/// drawn: generator/car.cpp.)
struct CarriedLoad {
  const char* name;  ///< "roof-box"
  const char* what;
  void (*add_to)(TexturedMesh& load);  ///< makes it of no parts
};
/// A roof box, a ladder, a mattress, a kayak, and boxes under a net.
const std::vector<CarriedLoad>& carried_loads();
/// The load of that name, x along the car, y left, z up (m), standing at z = 0 around the origin: closed
/// parts, one texel a face. InputError for a name that is none.
TexturedMesh carried_load(const std::string& name);

/// A run that has nothing but the objects: its adversary is the first, and its box the smallest around all of
/// them and the usual one.
Run run_of_objects(const std::vector<NamedObject>& objects);

}  // namespace mirage
