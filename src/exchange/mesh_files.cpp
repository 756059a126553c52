// Assimp's headers are heavy: no other file includes them.
#include "exchange/mesh_files.h"

#include <assimp/MemoryIOWrapper.h>
#include <assimp/material.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>
#include <fmt/format.h>

#include <algorithm>
#include <assimp/IOSystem.hpp>
#include <assimp/Importer.hpp>
#include <assimp/ProgressHandler.hpp>
#include <cctype>
#include <cstdint>
#include <cstring>
#include <functional>
#include <map>
#include <memory>
#include <optional>

#include "base/error.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/interrupt.h"
#include "exchange/folder_files.h"
#include "exchange/gltf_builder.h"
#include "exchange/gltf_document.h"
#include "exchange/ply_file.h"
#include "geometry/shapes.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;

std::string extension_of(const fs::path& file) {
  std::string extension = file.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension;
}

bool is_gltf(const std::string& extension) {
  return extension == ".glb" || extension == ".gltf";
}

bool readable(const std::string& extension) {
  return is_gltf(extension) || extension == ".obj" || extension == ".ply";
}

/// Where assimp's readers look for files: the mesh's folder, and nowhere else. Nothing is written.
class FolderSystem : public Assimp::IOSystem {
 public:
  /// `uris`: names are percent-encoded.
  FolderSystem(const FolderFiles& files, bool uris) : files_(files), uris_(uris) {}
  /// From here on there seems to be a file `name` that holds `text`.
  void pretend(const fs::path& name, std::string text) {
    pretended_ = name;
    text_ = std::move(text);
  }

  bool Exists(const char* name) const override { return name == pretended_ || locate(name).has_value(); }
  char getOsSeparator() const override { return '/'; }
  Assimp::IOStream* Open(const char* name, const char* mode) override {
    if (!std::strchr(mode, 'r')) return nullptr;
    if (name == pretended_) return stream(text_);
    const auto file = locate(name);
    if (!file) return nullptr;
    try {
      return stream(read_file(*file, uris_ ? kLargestFile : kLargestMesh));
    } catch (const InputError&) {
      return nullptr;
    }
  }
  void Close(Assimp::IOStream* stream) override { delete stream; }

 private:
  static Assimp::IOStream* stream(const std::string& bytes) {
    auto* copy = new std::uint8_t[bytes.size()];
    std::memcpy(copy, bytes.data(), bytes.size());
    return new Assimp::MemoryIOStream(copy, bytes.size(), true);
  }
  std::optional<fs::path> locate(const std::string& name) const {
    const auto decoded = uris_ ? percent_decoded(name) : std::nullopt;
    for (const std::string& spelt : {decoded.value_or(name), name}) {
      try {
        return files_.find(spelt, "");
      } catch (const InputError&) {
      }
    }
    return std::nullopt;
  }

  const FolderFiles& files_;
  bool uris_;
  fs::path pretended_;
  std::string text_;
};

std::string first_line(const std::string& text) {
  return text.substr(0, std::min<std::size_t>(text.find('\n'), 200));
}

/// Ends an import after Ctrl-C.
class UntilInterrupted : public Assimp::ProgressHandler {
 public:
  bool Update(float) override { return !interrupted(); }
};

Vec3d axis(const std::string& text, const std::string& what) {
  if (text.size() == 2 && (text[0] == '+' || text[0] == '-') && text[1] >= 'x' && text[1] <= 'z')
    return (text[0] == '+' ? 1.0 : -1.0) * Vec3d::Unit(text[1] - 'x');
  throw InputError(what, text, "is no axis", "give +x, -x, +y, -y, +z or -z");
}

/// Rows are the vehicle's x, y, z in the file's axes.
Eigen::Matrix3d vehicle_from_file(const MeshAxes& axes) {
  const Vec3d forward = axis(axes.forward, "forward axis"), up = axis(axes.up, "up axis");
  if (std::abs(forward.dot(up)) > 0.5)
    throw InputError("mesh axes", axes.forward + " and " + axes.up, "are parallel",
                     "give two different axes");
  Eigen::Matrix3d m;
  m.row(0) = forward;
  m.row(1) = up.cross(forward);
  m.row(2) = up;
  return m;
}

/// A material's base colour picture beside the file (or within it), or its plain colour.
class Colours {
 public:
  Colours(const aiScene& scene, const fs::path& file, const aiMaterial& material) {
    aiColor3D plain(0.5f, 0.5f, 0.5f);
    material.Get(AI_MATKEY_COLOR_DIFFUSE, plain);
    plain_ = {plain.r, plain.g, plain.b};
    aiString name;
    if (material.GetTexture(aiTextureType_BASE_COLOR, 0, &name) != aiReturn_SUCCESS &&
        material.GetTexture(aiTextureType_DIFFUSE, 0, &name) != aiReturn_SUCCESS)
      return;
    if (const aiTexture* within = scene.GetEmbeddedTexture(name.C_Str()); within && within->mHeight == 0)
      picture_ = decode_srgb({reinterpret_cast<const char*>(within->pcData), within->mWidth}, file.string(),
                             name.C_Str());
    else
      picture_ =
          read_srgb(FolderFiles(file).find(percent_decoded(name.C_Str()).value_or(name.C_Str()), "material"));
  }
  /// At a UV with its origin at the bottom left.
  Vec3d at(double u, double v) const {
    if (picture_.empty()) return plain_;
    const auto place = [](double share, int size) {
      return std::clamp(static_cast<int>(std::floor(share * size)), 0, size - 1);
    };
    const float* p = picture_.pixel(place(u, picture_.width), place(1 - v, picture_.height));
    return {p[0], p[1], p[2]};
  }

 private:
  Vec3d plain_;
  ImageF picture_;
};

InputError no_faces(const fs::path& file) {
  return {file.string(), "faces", "there are none", "export the mesh again"};
}

/// For assimp, whose reader of OBJ is the sturdier one.
std::string obj_text(const Polygons& polygons) {
  std::string text;
  for (const Vec3d& v : polygons.vertices)
    text += fmt::format("v {} {} {}\n", static_cast<float>(v.x()), static_cast<float>(v.y()),
                        static_cast<float>(v.z()));
  for (const std::vector<int>& face : polygons.faces) {
    text += 'f';
    for (const int corner : face) text += fmt::format(" {}", corner + 1);
    text += '\n';
  }
  return text;
}

/// InputError for a face of no or too many corners, or of corners that there are not.
void check_faces(const aiMesh& part, const std::string& where) {
  for (unsigned f = 0; f < part.mNumFaces; ++f) {
    const aiFace& face = part.mFaces[f];
    const std::string name = fmt::format("face {}", f);
    if (face.mNumIndices < 1 || face.mNumIndices > kMostCorners)
      throw InputError(where, name,
                       fmt::format("has {} corners, not 1 to {}", face.mNumIndices, kMostCorners),
                       "cut its polygons into triangles");
    for (unsigned k = 0; k < face.mNumIndices; ++k)
      if (face.mIndices[k] >= part.mNumVertices)
        throw InputError(where, name,
                         fmt::format("names vertex {} of {}", face.mIndices[k], part.mNumVertices),
                         "export the mesh again");
  }
}

/// read_mesh(), which tells `face_of` each face as it is added.
Mesh read_faces(const fs::path& file, const std::optional<MeshAxes>& axes,
                const std::function<void(const aiScene&, const aiMesh&, const aiFace&)>& face_of) {
  const std::string extension = extension_of(file);
  if (!readable(extension))
    throw InputError(file.string(), "extension", "is not one that is read", "give .glb, .gltf, .obj or .ply");
  const FolderFiles files(file);
  const bool gltf = is_gltf(extension);
  fs::path path = files.file();
  auto system = std::make_unique<FolderSystem>(files, gltf);
  if (gltf) {  // assimp's reader follows circles of nodes and deep JSON
    const GltfDocument document = open_gltf(file);
    // … and takes the first buffer of a .glb for its binary chunk, whatever its uri says.
    if (extension == ".glb" && document.json.contains("buffers") && !document.json["buffers"].empty() &&
        document.json["buffers"][0].contains("uri"))
      system->pretend(path += ".gltf", document.json.dump());
  }
  if (extension == ".ply") {
    const Polygons polygons = parse_ply(read_file(file, kLargestMesh), file.string());
    if (polygons.faces.empty()) throw no_faces(file);
    system->pretend(path += ".obj", obj_text(polygons));
  }
  Assimp::Importer importer;
  importer.SetIOHandler(system.release());  // both are the importer's from here on
  importer.SetProgressHandler(new UntilInterrupted);
  importer.SetPropertyInteger(AI_CONFIG_PP_SBP_REMOVE, aiPrimitiveType_POINT | aiPrimitiveType_LINE);
  const auto ready = [&](const aiScene* scene) {
    throw_if_interrupted("nothing was written");
    if (!scene)
      throw InputError(file.string(), "", first_line(importer.GetErrorString()), "export the mesh again");
    return scene;
  };
  const aiScene* scene = ready(importer.ReadFile(path.string(), 0));
  // The steps that follow end the program at faces without corners, and take the square of their number.
  for (unsigned m = 0; m < scene->mNumMeshes; ++m) check_faces(*scene->mMeshes[m], file.string());
  scene = ready(importer.ApplyPostProcessing(aiProcess_Triangulate | aiProcess_PreTransformVertices |
                                             aiProcess_JoinIdenticalVertices | aiProcess_SortByPType));
  const Eigen::Matrix3d turn =
      vehicle_from_file(axes.value_or(gltf ? MeshAxes{"+z", "+y"} : MeshAxes{"+x", "+z"}));
  Mesh mesh;
  for (unsigned m = 0; m < scene->mNumMeshes; ++m) {
    const aiMesh& part = *scene->mMeshes[m];
    const int first = static_cast<int>(mesh.vertices.size());
    for (unsigned v = 0; v < part.mNumVertices; ++v) {
      const aiVector3D& p = part.mVertices[v];
      mesh.vertices.push_back(turn * Vec3d(p.x, p.y, p.z));
    }
    for (unsigned f = 0; f < part.mNumFaces; ++f) {
      const aiFace& face = part.mFaces[f];
      if (face.mNumIndices != 3) continue;
      mesh.faces.push_back({first + static_cast<int>(face.mIndices[0]),
                            first + static_cast<int>(face.mIndices[1]),
                            first + static_cast<int>(face.mIndices[2])});
      face_of(*scene, part, face);
    }
  }
  for (std::size_t v = 0; v < mesh.vertices.size(); ++v)
    if (!(mesh.vertices[v].cwiseAbs().maxCoeff() <= gltf_limits::kFurthest))
      throw InputError(file.string(), fmt::format("vertex {}", v),
                       fmt::format("is not within {:g} m", gltf_limits::kFurthest),
                       "export the mesh in metres");
  if (mesh.faces.empty()) throw no_faces(file);
  check_mesh({mesh, {}}, file.string());
  return mesh;
}

}  // namespace

Mesh read_mesh(const fs::path& file, const std::optional<MeshAxes>& axes) {
  return read_faces(file, axes, [](const aiScene&, const aiMesh&, const aiFace&) {});
}

TexturedMesh read_textured_mesh(const fs::path& file, const std::optional<MeshAxes>& axes) {
  TexturedMesh result;
  result.atlas.resolution = 1;
  std::map<unsigned, Colours> materials;
  result.mesh = read_faces(file, axes, [&](const aiScene& scene, const aiMesh& part, const aiFace& face) {
    const auto& colours =
        materials.try_emplace(part.mMaterialIndex, scene, file, *scene.mMaterials[part.mMaterialIndex])
            .first->second;
    double u = 0, v = 0;
    if (part.HasTextureCoords(0))
      for (int k = 0; k < 3; ++k) {
        const aiVector3D& uv = part.mTextureCoords[0][face.mIndices[k]];
        u += uv.x / 3.0;
        v += uv.y / 3.0;
      }
    result.atlas.texels.push_back(colours.at(u, v));
  });
  return result;
}

std::vector<ShapeSample> read_vehicle_meshes(const fs::path& folder, const std::optional<MeshAxes>& axes) {
  if (!fs::is_directory(folder))
    throw InputError(folder.string(), "", "is not a folder",
                     "give a folder with .glb, .gltf, .obj or .ply files");
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder))
    if (entry.is_regular_file() && readable(extension_of(entry.path()))) files.push_back(entry.path());
  if (files.empty())
    throw InputError(folder.string(), "", "holds no meshes", "put .glb, .gltf, .obj or .ply files there");
  std::sort(files.begin(), files.end());
  std::vector<ShapeSample> samples;
  for (const fs::path& file : files) {
    Mesh mesh = read_mesh(file, axes);
    const Vec3d s = bounds(mesh).sizes();
    if (!(s.x() >= 2 && s.x() <= 12 && s.y() >= 1 && s.y() <= 3.5 && s.z() >= 0.8 && s.z() <= 4.5 &&
          s.x() > s.y()))
      throw InputError(
          file.string(), "size",
          fmt::format("{:.2f} m long, {:.2f} m wide, {:.2f} m high is no vehicle", s.x(), s.y(), s.z()),
          "export it in metres and name its axes (--mesh-forward, --mesh-up)");
    samples.push_back({std::move(mesh), "user"});
  }
  return samples;
}

void write_mesh(const fs::path& file, const Mesh& mesh) {
  const std::string extension = extension_of(file);
  std::vector<float> positions;
  std::vector<std::uint32_t> indices;
  const Eigen::Matrix3d turn =
      extension == ".glb" ? gltf_from_velo() : Eigen::Matrix3d(Eigen::Matrix3d::Identity());
  for (const Vec3d& v : mesh.vertices) {
    const Vec3d p = turn * v;
    for (int k = 0; k < 3; ++k) positions.push_back(static_cast<float>(p[k]));
  }
  for (const Face& f : mesh.faces) indices.insert(indices.end(), f.begin(), f.end());
  if (extension == ".glb") {
    constexpr int kUnsigned = 5125, kElements = 34963;  // GL's names for indices
    GltfBuilder gltf;
    const int position = gltf.add_floats(positions, 3, true);
    const int index = gltf.add("accessors", {{"bufferView", gltf.add_view(indices, kElements)},
                                             {"componentType", kUnsigned},
                                             {"count", indices.size()},
                                             {"type", "SCALAR"}});
    const nlohmann::json primitive = {{"attributes", {{"POSITION", position}}}, {"indices", index}};
    const std::string name = file.stem().string();
    const int number =
        gltf.add("meshes", {{"name", name}, {"primitives", nlohmann::json::array({primitive})}});
    gltf.add_node({{"name", name}, {"mesh", number}});
    write_file(file, gltf.glb());
  } else if (extension == ".ply") {
    std::string out = fmt::format(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
        "property float z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.vertices.size(), mesh.faces.size());
    out.append(reinterpret_cast<const char*>(positions.data()), positions.size() * sizeof(float));
    for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
      out.push_back(3);
      out.append(reinterpret_cast<const char*>(&indices[3 * f]), 3 * sizeof(std::uint32_t));
    }
    write_file(file, out);
  } else {
    throw InputError(file.string(), "extension", "is not one that is written", "give .glb or .ply");
  }
}

}  // namespace mirage
