// The files that a scene or mesh may name.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include "base/error.h"
#include "base/files.h"
#include "documents.h"
#include "exchange/gltf.h"
#include "exchange/mesh_files.h"
#include "support/files.h"

namespace mirage {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using test::error_text;
using test::triangle_bytes;
using test::triangle_document;
using test::write_glb;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

/// Changes the working directory for its lifetime.
class InFolder {
 public:
  explicit InFolder(const fs::path& folder) { fs::current_path(folder); }
  ~InFolder() { fs::current_path(before_); }

 private:
  fs::path before_ = fs::current_path();
};

TEST(GltfFiles, ABufferBesideTheFileIsReadFromAnyWorkingDirectory) {
  const test::TemporaryFolder folder;
  fs::create_directories(folder / "set/sub folder");
  write_file(folder / "set/sub folder/a+b.bin", triangle_bytes());
  fs::create_symlink("sub folder/a+b.bin", folder / "set/link.bin");
  const InFolder there(folder.path());
  for (const char* uri : {"sub%20folder/a+b.bin", "./sub%20folder/../link.bin", "link.bin"}) {
    write_glb(folder / "set/scene.glb", triangle_document(uri));
    write_file(folder / "set/scene.gltf", triangle_document(uri).dump());
    for (const fs::path& from : {folder.path(), folder / "set", fs::path("/")}) {
      fs::current_path(from);
      const fs::path near = fs::relative(folder / "set", from);
      EXPECT_EQ(read_adversary(near / "scene.glb").mesh.faces.size(), 1u) << uri << " from " << from;
      EXPECT_EQ(read_mesh(near / "scene.glb").faces.size(), 1u) << uri << " from " << from;
      EXPECT_EQ(read_mesh(near / "scene.gltf").faces.size(), 1u) << uri << " from " << from;
    }
  }
}

TEST(GltfFiles, NothingOutsideTheFoldersOpened) {
  const test::TemporaryFolder folder;
  fs::create_directories(folder / "set");
  fs::create_directories(folder / "set2");  // its name begins as the folder's
  const std::string secret = "TOPSECRET" + std::string(27, '!');
  write_file(folder / "secret.bin", secret);
  write_file(folder / "set2/secret.bin", secret);
  fs::create_symlink("../secret.bin", folder / "set/link.bin");
  fs::create_symlink("..", folder / "set/up");
  ASSERT_EQ(mkfifo((folder / "set/pipe").c_str(), 0600), 0);
  ASSERT_EQ(mkfifo((folder / "pipe").c_str(), 0600), 0);
  const InFolder there(folder.path());  // names relative to the working directory would be found
  for (const std::string& uri :
       {(folder / "secret.bin").string(), std::string("../secret.bin"), std::string("%2e%2e%2fsecret.bin"),
        std::string("..%2Fsecret.bin"), std::string("secret.bin"), std::string("link.bin"),
        std::string("up/secret.bin"), std::string("../set2/secret.bin"), std::string("pipe"),
        std::string("../pipe"), std::string("/dev/zero"), std::string("/proc/self/environ"),
        std::string("file:///etc/passwd"), std::string("."), std::string(""), std::string("a%00.bin"),
        std::string("a%zz.bin"), std::string("~/secret.bin"), std::string("$(id).bin")}) {
    for (const char* name : {"set/scene.glb", "set/scene.gltf"}) {
      const std::string bytes = triangle_document(uri).dump();
      if (std::string(name).ends_with("glb"))
        write_glb(folder / name, triangle_document(uri));
      else
        write_file(folder / name, bytes);
      const auto expected =
          AllOf(HasSubstr(name), HasSubstr("buffers[0]"), Not(HasSubstr("TOPSECRET")), Not(HasSubstr("\n")));
      EXPECT_THAT(error_text<InputError>([&] { read_mesh(name); }), expected) << uri;
      if (std::string(name).ends_with("glb")) {
        EXPECT_THAT(error_text<InputError>([&] { read_adversary(name); }), expected) << uri;
        EXPECT_THAT(error_text<InputError>([&] { read_scene(name, 8, 8); }), expected) << uri;
      }
    }
  }
}

TEST(GltfFiles, BuffersAreBoundedTogether) {
  const test::TemporaryFolder folder;
  write_file(folder / "hole.bin", triangle_bytes());
  fs::resize_file(folder / "hole.bin", std::uintmax_t{1} << 30);
  json document = triangle_document("hole.bin");
  EXPECT_EQ((write_glb(folder / "scene.glb", document), read_mesh(folder / "scene.glb").faces.size()), 1u);
  for (int i = 0; i < 3; ++i)
    document["buffers"].push_back({{"byteLength", std::uintmax_t{100} << 20}, {"uri", "hole.bin"}});
  write_glb(folder / "scene.glb", document);
  EXPECT_THAT(error_text<InputError>([&] { read_mesh(folder / "scene.glb"); }),
              AllOf(HasSubstr("buffers[3]"), HasSubstr("with those before it")));
}

TEST(GltfFiles, PicturesInFilesOfTheirOwnAreNotOpened) {
  const test::TemporaryFolder folder;
  ASSERT_EQ(mkfifo((folder / "pipe.png").c_str(), 0600), 0);
  write_file(folder / "a.bin", triangle_bytes());
  json document = triangle_document("a.bin");
  document["images"] = {{{"uri", "pipe.png"}}, {{"uri", "/dev/zero"}}, {{"uri", "a.bin"}}};
  document["textures"] = {{{"source", 0}}};
  write_glb(folder / "scene.glb", document);
  EXPECT_EQ(read_adversary(folder / "scene.glb").mesh.faces.size(), 1u);
  EXPECT_EQ(read_mesh(folder / "scene.glb").faces.size(), 1u);
}

TEST(GltfFiles, ABufferThatIsTooShortSaysSo) {
  const test::TemporaryFolder folder;
  write_file(folder / "a.bin", triangle_bytes().substr(0, 20));
  write_glb(folder / "scene.glb", triangle_document("a.bin"));
  EXPECT_THAT(error_text<InputError>([&] { read_adversary(folder / "scene.glb"); }),
              AllOf(HasSubstr("buffers[0]"), HasSubstr("20 bytes of 36")));
}

TEST(GltfFiles, APipeAsTheSceneIsNotWaitedFor) {
  const test::TemporaryFolder folder;
  for (const char* name : {"pipe.glb", "pipe.obj", "pipe.ply"}) {
    ASSERT_EQ(mkfifo((folder / name).c_str(), 0600), 0);
    EXPECT_THAT(error_text<InputError>([&] { read_mesh(folder / name); }), HasSubstr("not a regular file"));
  }
  EXPECT_THAT(error_text<InputError>([&] { read_adversary(folder / "pipe.glb"); }),
              HasSubstr("not a regular file"));
}

TEST(MeshFolder, MaterialsOfAnObjComeFromItsOwnFolderOnly) {
  const test::TemporaryFolder folder;
  fs::create_directories(folder / "set");
  ASSERT_EQ(mkfifo((folder / "pipe.mtl").c_str(), 0600), 0);
  ASSERT_EQ(mkfifo((folder / "set/pipe.mtl").c_str(), 0600), 0);
  write_file(folder / "set/good.mtl", "newmtl paint\nKd 1 0 0\nmap_Kd /dev/zero\n");
  const InFolder there(folder.path());
  for (const std::string& library :
       {std::string("good.mtl"), std::string("pipe.mtl"), std::string("../pipe.mtl"),
        (folder / "pipe.mtl").string(), std::string("/dev/zero")}) {
    write_file("set/car.obj", "mtllib " + library + "\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl paint\nf 1 2 3\n");
    EXPECT_EQ(read_mesh("set/car.obj").faces.size(), 1u) << library;
  }
}

}  // namespace
}  // namespace mirage
