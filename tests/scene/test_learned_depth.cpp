// Back-ends by name, and every way a depth completion plugin can be wrong: one clear line each.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "base/error.h"
#include "base/files.h"
#include "scene/depth/learned_depth.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using testing::HasSubstr;
using testing::Not;

DepthOptions fake(const std::string& kind) {
  DepthOptions options;
  options.backend = std::string(MIRAGE_BUILD) + "/test_plugins/fake_depth_" + kind + ".so";
  options.fresh = true;
  return options;
}

std::string load_error(const DepthOptions& options) {
  const std::string text = error_text<InputError>([&] { load_depth_completion(options); });
  EXPECT_THAT(text, Not(HasSubstr("\n")));
  return text;
}

struct Picture {
  ImageF image{6, 4, 3, 0.5f}, sparse{6, 4, 1};
};

TEST(DepthBackEnds, ClassicalOnesByName) {
  for (const char* name : {"ip-basic", "ip-basic-bilateral", "ip-basic-multiscale",
                           "ip-basic-multiscale-bilateral", "ip-basic-extrapolated"})
    EXPECT_EQ(load_depth_completion({name})->name(), name);
  if (!std::filesystem::exists(MIRAGE_BUILD "/plugins/guided.so"))
    GTEST_SKIP() << "other names are asked of a plugin that was not built";
  EXPECT_THAT(load_error({"magic"}), HasSubstr("magic: unknown; use ip-basic"));
  EXPECT_THAT(load_error({"ip-basic-magic"}), HasSubstr("ip-basic-magic"));
}

TEST(DepthBackEnds, RunsAPluginThatWorks) {
  const auto completion = load_depth_completion(fake("works"));
  EXPECT_EQ(completion->name(), "fake");
  Picture picture;
  picture.sparse.data[3] = 7;
  picture.sparse.data[4] = std::nanf("");
  picture.sparse.data[5] = -2;
  const ImageF dense = completion->complete(picture.image, picture.sparse);
  EXPECT_EQ(dense.data[3], 7);
  for (std::size_t i = 0; i < dense.data.size(); ++i)
    if (i != 3) {
      EXPECT_EQ(dense.data[i], kFarDepth);  // no return, not a number, negative: nothing
    }
  EXPECT_TRUE(completion->complete({}, {}).empty());
}

TEST(DepthBackEnds, WrongPluginsAreNamed) {
  EXPECT_THAT(load_error({"/nowhere/depth.so"}), HasSubstr("/nowhere/depth.so: no such depth completion"));
  EXPECT_THAT(load_error(fake("no_entry")), HasSubstr("mirage_depth_api: the plugin lacks this entry point"));
  EXPECT_THAT(load_error(fake("wrong_abi")), HasSubstr("abi_version: is 999, this program speaks 1"));
  EXPECT_THAT(load_error(fake("refuses")), HasSubstr("these weights are for another network"));
  EXPECT_THAT(error_text<Failure>([] { load_depth_completion(fake("throws_in_create")); }),
              HasSubstr("create threw an exception (thrown on purpose)"));
  test::TemporaryFolder folder;
  write_file(folder / "text.so", "this is text");
  DepthOptions text;
  text.backend = folder / "text.so";
  text.fresh = true;
  EXPECT_THAT(load_error(text), HasSubstr("not a loadable plugin"));
}

TEST(DepthBackEnds, PluginsThatFailLater) {
  const Picture picture;
  const auto run = [&](const char* kind) {
    const auto completion = load_depth_completion(fake(kind));
    return error_text<Failure>([&] { completion->complete(picture.image, picture.sparse); });
  };
  EXPECT_THAT(run("throws_in_run"), HasSubstr("complete threw an exception (thrown on purpose)"));
  EXPECT_THAT(run("fails_in_run"), HasSubstr("complete failed (out of luck)"));
  EXPECT_THAT(run("not_finite"), HasSubstr("not finite"));
}

TEST(DepthBackEnds, BadPicturesAreReported) {
  const auto completion = load_depth_completion(fake("works"));
  Picture picture;
  picture.image.at(2, 1, 1) = std::nanf("");
  EXPECT_THAT(error_text<InputError>([&] { completion->complete(picture.image, picture.sparse); }),
              HasSubstr("pixel (2, 1)"));
  EXPECT_THAT(error_text<InputError>([&] { completion->complete(ImageF(5, 4, 3), picture.sparse); }),
              HasSubstr("not an RGB picture of the sparse depth's size"));
}

TEST(DepthBackEnds, MissingWeights) {
  DepthOptions options = fake("works");
  options.fresh = false;
  EXPECT_THAT(load_error(options), HasSubstr("shipped weights are missing"));
  options.weights = "/nowhere/my.weights";
  EXPECT_THAT(load_error(options), HasSubstr("/nowhere/my.weights: no such weights file"));
}

}  // namespace
}  // namespace mirage
