// mirage render: meaningless options are refused, and cameras of another scene leave no files.
#include "cli/program.h"
#include "fixture.h"

namespace mirage {
namespace {

class Render : public test::Program {
 protected:
  const PreparedFrame prepared_ = test::made_up_frame();
  const HostScene scene_ = test::host_scene_of(prepared_, test::random_mesh(2), "render");
  const std::string of_scene_ = "render --window 500,100,700,250 --scene " + scene_.glb.string() + " --out ";
};

TEST_F(Render, TheTracedCameraRefusesSoftness) {
  const std::string traced = of_scene_ + at("out") + " --renderer traced";
  EXPECT_THAT(refused(traced + " --sigma 1e-3"), testing::HasSubstr("--sigma: 1e-3: means nothing"));
  EXPECT_THAT(refused(traced + " --gamma 0.5"), testing::HasSubstr("--gamma"));
  EXPECT_EQ(mirage(traced), 0) << said();
  EXPECT_EQ(mirage(of_scene_ + at("out") + " --sigma 1e-3 --gamma 0.5"), 0) << said();
}

TEST_F(Render, OtherCamerasOfAnEarlierSceneGo) {
  write_json(folder_ / "result.json", {{"cameras", {{"SIDE", 5}, {"../SIDE", 5}}}});
  for (const char* file : {"image-SIDE.png", "image-SIDE.exr", "depth-SIDE.exr", "image-mine.png"})
    write_file(folder_ / file, "an earlier scene's");
  ASSERT_EQ(mirage(of_scene_ + folder_.path().string()), 0) << said();
  for (const char* file : {"image-SIDE.png", "image-SIDE.exr", "depth-SIDE.exr"})
    EXPECT_FALSE(exists(file)) << file;
  EXPECT_TRUE(exists("image-mine.png"));
  EXPECT_TRUE(exists("image.png"));
}

}  // namespace
}  // namespace mirage
