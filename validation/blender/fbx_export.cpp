#include "validation/blender/fbx_export.h"

#include <fmt/format.h>

#include "base/files.h"
#include "exchange/gltf.h"
#include "exchange/obj_file.h"

namespace mirage {

void write_fbx(BlenderWorker& blender, const std::filesystem::path& file, const TexturedMesh& adversary) {
  namespace fs = std::filesystem;
  constexpr double kTimeout = 300;  // s; it takes one or two
  const auto beside = [&](const char* extension) {
    return fs::absolute(file).parent_path() / fmt::format(".{}.part{}", file.stem().string(), extension);
  };
  const fs::path mesh = beside(".glb"), fbx = beside(".fbx");
  struct Remove {
    const fs::path& file;
    ~Remove() {
      std::error_code ignored;
      fs::remove(file, ignored);
    }
  } const mesh_after{mesh}, fbx_after{fbx};
  write_adversary(mesh, standing_on_origin(adversary));
  blender.request({{"job", "fbx"}, {"mesh", mesh.string()}, {"output", fbx.string()}}, kTimeout);
  replace_file(fbx, file);
}

}  // namespace mirage
