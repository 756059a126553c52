// The adversary as FBX, by Blender's own exporter (fbx_file.py).
#pragma once

#include <filesystem>

#include "geometry/mesh.h"
#include "validation/blender/blender_process.h"

namespace mirage {

/// Writes standing_on_origin(adversary) (exchange/obj_file.h): metres, pivot on the roof socket, one material
/// whose embedded picture has the texels at 8 bits sRGB, a pixel each. Written beside `file` first, so that
/// what is there is whole. Errors of BlenderWorker::request.
void write_fbx(BlenderWorker& blender, const std::filesystem::path& file, const TexturedMesh& adversary);

}  // namespace mirage
