#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <sstream>

#include "attack/buildable.h"
#include "attack/run.h"
#include "base/files.h"
#include "base/image.h"
#include "base/json_fields.h"
#include "base/random.h"
#include "base/sizes.h"
#include "support/files.h"
#include "support/print_profile.h"

namespace mirage {
namespace {

using testing::AllOf;
using testing::HasSubstr;

PrintGamut gamut_of(const std::string& text) {
  PrintGamut gamut;
  set_from_text(text, gamut);
  return gamut;
}

std::string chart(const std::string& columns, const std::vector<std::string>& rows) {
  std::string text = "CTI3\nNUMBER_OF_FIELDS 4\nBEGIN_DATA_FORMAT\nSAMPLE_ID " + columns +
                     "\nEND_DATA_FORMAT\nNUMBER_OF_SETS " + std::to_string(rows.size()) + "\nBEGIN_DATA\n";
  for (std::size_t i = 0; i < rows.size(); ++i) text += std::to_string(i + 1) + " " + rows[i] + "\n";
  return text + "END_DATA\n";
}

/// The colours of FOGRA39's overprints, XYZ for D50.
std::vector<Vec3d> fogra39() {
  const std::string text = read_file(shipped_file("scenes/prints/fogra39.ti3"));
  std::istringstream lines(text.substr(text.find("BEGIN_DATA\n") + 11));
  std::vector<Vec3d> patches(16);
  for (int row = 0; row < 16; ++row) {
    double number, c, m, y, k;
    Vec3d xyz;
    lines >> number >> c >> m >> y >> k >> xyz.x() >> xyz.y() >> xyz.z();
    patches[as_size((c > 0) + 2 * (m > 0) + 4 * (y > 0) + 8 * (k > 0))] = xyz / 100;
  }
  return patches;
}

// sRGB's red is (0.4360, 0.2225, 0.0139) for D50, its green and blue likewise (IEC 61966-2-1 by Bradford, as
// in ICC's own sRGB profile).
TEST(PrintGamut, AChartsColoursBecomeLinearRgb) {
  const test::TemporaryFolder folder;
  const auto file = folder / "chart.txt";
  // Patches at 10 % of white plus 80 % of each primary.
  const std::vector<Vec3d> patches = {
      {9.642, 10, 8.249}, {44.528, 27.799, 9.363}, {40.454, 67.350, 16.015}, {21.088, 14.849, 65.377}};
  std::vector<std::string> measured, rows;
  for (const Vec3d& p : patches) measured.push_back(fmt::format("{} {} {}", p.x(), p.y(), p.z()));
  write_file(file, chart("XYZ_X XYZ_Y XYZ_Z", measured));
  const PrintGamut gamut = gamut_of(file.string());
  ASSERT_EQ(gamut.colours().size(), 4u);
  for (int k = 0; k < 3; ++k)
    EXPECT_LT((gamut.colours()[as_size(k + 1)] - (Vec3d::Constant(0.1) + 0.8 * Vec3d::Unit(k))).norm(), 1e-3);
  EXPECT_EQ(gamut.name(), file.string());

  // The same patches as Lab.
  for (const Vec3d& p : patches) {
    const Vec3d xyz = p / 100;
    const cmsCIEXYZ from{xyz.x(), xyz.y(), xyz.z()};
    cmsCIELab lab;
    cmsXYZ2Lab(nullptr, &lab, &from);
    rows.push_back(fmt::format("{} {} {}", lab.L, lab.a, lab.b));
  }
  write_file(folder / "lab.txt", chart("LAB_L LAB_A LAB_B", rows));
  const PrintGamut same = gamut_of((folder / "lab.txt").string());
  ASSERT_EQ(same.colours().size(), 4u);
  for (std::size_t i = 0; i < 4; ++i) EXPECT_LT((same.colours()[i] - gamut.colours()[i]).norm(), 1e-6);
}

TEST(PrintGamut, AnOffsetPrintHasPaperAndNoSaturatedGreen) {
  const PrintGamut gamut;
  EXPECT_EQ(gamut.name(), "fogra39");
  EXPECT_EQ(gamut.colours(), gamut_of("fogra39").colours());
  // Mixtures of paper and black, between their reflectances of 0.876 and 0.021.
  EXPECT_TRUE(gamut.holds(Vec3d::Constant(0.3)));
  EXPECT_FALSE(gamut.holds(Vec3d::Constant(0.9)));
  EXPECT_FALSE(gamut.holds(Vec3d::Zero()));
  EXPECT_FALSE(gamut.holds({0.03, 0.85, 0.03}));
  EXPECT_FALSE(gamut.holds({0.03, 0.03, 0.85}));
  EXPECT_TRUE(gamut_of("box:0.03,0.85").holds({0.03, 0.85, 0.03}));
  for (const Vec3d& colour : gamut.colours()) {
    EXPECT_TRUE(gamut.holds(colour));
    EXPECT_GE(colour.minCoeff(), 0.0);
    EXPECT_LE(colour.maxCoeff(), 1.0);
  }
}

TEST(PrintGamut, AProfileHasTheGamutOfItsOverprints) {
  const test::TemporaryFolder folder;
  write_file(folder / "printer.icc", test::print_profile(fogra39()));
  const PrintGamut profile = gamut_of((folder / "printer.icc").string()), measured;
  // 16-bit Lab: 0.004 in a and b, which is at most 1e-4 of XYZ after the cube.
  for (const Vec3d& colour : measured.colours())
    EXPECT_LT((profile.nearest(colour) - colour).norm(), 5e-4) << colour.transpose();
  for (const Vec3d& colour : profile.colours())
    EXPECT_LT((measured.nearest(colour) - colour).norm(), 5e-4) << colour.transpose();
}

TEST(PrintGamut, TexelsGoToTheNearestColourThatIsPrinted) {
  BuildableSettings settings;
  TexturedMesh adversary = initial_adversary();
  make_buildable(adversary, settings, {});
  const TexturedMesh before = adversary;
  RandomStream random(4, "texels", 0);
  for (Vec3d& t : adversary.atlas.texels)
    for (double& c : t) c = random.uniform();
  const std::vector<Vec3d> wanted = adversary.atlas.texels;
  EXPECT_LT(buildable_report(adversary, settings).printable, 0.7);
  keep_buildable(adversary, before, settings, {});
  EXPECT_EQ(buildable_report(adversary, settings).printable, 1.0);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    const Vec3d& texel = adversary.atlas.texels[i];
    kept += texel == wanted[i];
    for (const Vec3d& colour : settings.gamut.colours())
      EXPECT_LE((wanted[i] - texel).dot(colour - texel), 1e-9);
  }
  EXPECT_GT(kept, wanted.size() / 20);
  // An 8-bit picture rounds each channel by half a level: at the steepest part of sRGB's curve.
  for (Vec3d& t : adversary.atlas.texels)
    for (double& c : t) {
      const float level = std::round(255 * srgb_from_linear(static_cast<float>(c)));
      c = static_cast<double>(linear_level(static_cast<std::uint8_t>(level)));
    }
  for (const Vec3d& t : adversary.atlas.texels)
    EXPECT_LT((settings.gamut.nearest(t) - t).cwiseAbs().maxCoeff(), 0.5 / 255 * 2.4 / 1.055 * 1.1);
}

TEST(PrintGamut, WhatIsNoPrintIsOneLine) {
  const test::TemporaryFolder folder;
  const auto said = [&](const std::string& bytes) {
    write_file(folder / "print.txt", bytes);
    return test::error_text<InputError>([&] { gamut_of((folder / "print.txt").string()); });
  };
  const std::vector<std::string> grey = {"10 10 10", "20 20 20", "30 30 30", "40 40 40"};
  const std::string file = (folder / "print.txt").string();
  EXPECT_THAT(said(""), AllOf(HasSubstr(file), HasSubstr("ICC profile")));
  EXPECT_THAT(said("what?"), HasSubstr(file));
  EXPECT_THAT(said(chart("RGB_R RGB_G RGB_B", grey)), HasSubstr("BEGIN_DATA_FORMAT: has neither XYZ_X"));
  EXPECT_THAT(said(chart("XYZ_X XYZ_Y XYZ_Z", grey)), HasSubstr("patches lie in one plane"));
  EXPECT_THAT(said(chart("XYZ_X XYZ_Y XYZ_Z", {"1 1 1", "2 2 2", "3 3 3"})),
              HasSubstr("NUMBER_OF_SETS: is not a number of patches"));
  EXPECT_THAT(said(chart("XYZ_X XYZ_Y XYZ_Z", {"1 1 1", "2 2 2", "3 900 3", "4 4 4"})),
              HasSubstr("XYZ_Y of patch 3: 900 is not a measured colour"));
  EXPECT_THAT(said("CTI3\n.INCLUDE \"/etc/passwd\"\n"), HasSubstr("INCLUDE: names another file"));
  std::string profile = test::print_profile(fogra39());
  EXPECT_THAT(said(profile.substr(0, 200)), HasSubstr(file));
  profile.replace(16, 4, "RGB ");
  EXPECT_THAT(said(profile), HasSubstr("colour space: is not the profile of a CMYK printer"));
  for (const char* wrong : {"fogra93", "nowhere.icc", "box:1", "box:0.8,0.2", "box:0,2", "box:x,1"})
    EXPECT_THAT(test::error_text<FieldError>([&] { gamut_of(wrong); }),
                AllOf(HasSubstr("gamut: "), HasSubstr(wrong)));
}

TEST(PrintGamut, ARunTellsItsColours) {
  const test::TemporaryFolder folder;
  write_file(folder / "chart.txt",
             chart("XYZ_X XYZ_Y XYZ_Z", {"2 2 2", "40 30 10", "30 40 10", "20 20 50", "80 85 70"}));
  AttackSettings settings;
  settings.rooftop = "box";
  settings.buildable.gamut = gamut_of((folder / "chart.txt").string());
  const nlohmann::json before = identity(settings).json;
  ASSERT_TRUE(before.contains("gamut_colours"));
  const PrintGamut again = read_gamut(before.at("gamut_colours"), "run.json", "gamut_colours", "chart");
  EXPECT_EQ(again.colours(), settings.buildable.gamut.colours());
  EXPECT_EQ(again.nearest({1, 0, 0}), settings.buildable.gamut.nearest({1, 0, 0}));
  // The same file name with other content makes another run.
  write_file(folder / "chart.txt",
             chart("XYZ_X XYZ_Y XYZ_Z", {"2 2 2", "40 30 10", "30 40 10", "20 20 50", "80 85 71"}));
  settings.buildable.gamut = gamut_of((folder / "chart.txt").string());
  EXPECT_NE(identity(settings).json.at("gamut_colours"), before.at("gamut_colours"));

  for (const auto& wrong : {nlohmann::json(3), nlohmann::json{{1, 2}}, nlohmann::json{{0, 0, 2}},
                            nlohmann::json{{0, 0, "x"}}, nlohmann::json::array()})
    EXPECT_THAT(test::error_text<InputError>([&] { read_gamut(wrong, "run.json", "gamut_colours", "x"); }),
                HasSubstr("run.json: gamut_colours"));
}

TEST(PrintGamut, AnEarlierRunHasItsBlackAndWhite) {
  nlohmann::json run = fields_json(AttackSettings());
  run["buildable"] = {0.01, 0.1, 0.05, 0.8};
  run.erase("gamut");
  AttackSettings read;
  read_fields(JsonFields("run.json", run, "restore it"), read);
  EXPECT_EQ(read.buildable.base, 0.1);
  EXPECT_EQ(read.buildable.gamut.name(), "box:0.05,0.8");
  EXPECT_LT((read.buildable.gamut.nearest({0, 0.5, 1}) - Vec3d(0.05, 0.5, 0.8)).norm(), 1e-15);
  AttackSettings again;
  read_fields(JsonFields("run.json", fields_json(read), "restore it"), again);
  EXPECT_EQ(again.buildable.gamut.name(), "box:0.05,0.8");
  run["buildable"] = {0.01, 0.1, 0.9, 0.8};
  EXPECT_THAT(
      test::error_text<InputError>([&] { read_fields(JsonFields("run.json", run, "restore it"), read); }),
      HasSubstr("run.json: buildable"));
}

}  // namespace
}  // namespace mirage
