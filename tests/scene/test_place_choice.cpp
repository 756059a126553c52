#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "scene/place_choice.h"
#include "support/files.h"

namespace mirage {
namespace {

using testing::HasSubstr;

std::string normal(const std::string& text) {
  PlaceChoice place;
  set_from_text(text, place);
  return text_of(place);
}

TEST(Place, HasOneTextHoweverItIsSpelt) {
  EXPECT_EQ(normal("roof"), "roof");
  for (const char* text : {"2,0,0.5,90", "+2.0,-0,5e-1,450", "2.00,0,.5,-270"})
    EXPECT_EQ(normal(text), "2,0,0.5,90") << text;
  for (const char* text : {"world:1,2,3,180", "world:1,2,3,-180", "world:1,2,3,540"})
    EXPECT_EQ(normal(text), "world:1,2,3,180") << text;
  EXPECT_EQ(normal("0,0,0,360.1"), normal("0,0,0,0.1"));
  EXPECT_NE(normal("1,2,3,4"), normal("world:1,2,3,4"));
  for (const char* text : {"-1.25,0.3,1e-3,-179.9", "world:999.5,0,-1.7,0"})
    EXPECT_EQ(normal(normal(text)), normal(text)) << text;
}

TEST(Place, OtherTextsAreRefusedInALineThatSaysWhatToUse) {
  for (const char* text :
       {"", "thatched", "roof,", "1,2,3", "1,2,3,4,5", "1,2,3,x", "world:", "world:roof", "1001,0,0,0",
        "nan,0,0,0", "0,0,inf,0", "0,0,0,inf", "0,0,0,nan", "velo:1,2,3,4"}) {
    const std::string said = test::error_text<FieldError>([&] { normal(text); });
    EXPECT_THAT(said, testing::StartsWith("placement: ")) << text;
    EXPECT_EQ(said.find('\n'), std::string::npos) << text;
  }
}

PlaceChoice place_of_text(const std::string& text) {
  PlaceChoice place;
  set_from_text(text, place);
  return place;
}

TEST(Place, TheRoofsFileSaysWhatTheProgramTakesWithoutAny) {
  nlohmann::json said = to_json(place_of_text("roof"));
  EXPECT_FALSE(said.at("what").empty());
  said["what"] = "";
  EXPECT_EQ(said, to_json(PlaceChoice()));
  EXPECT_EQ(content_of(place_of_text("roof")), "roof");  // the value in runs from before placement files
  EXPECT_EQ(content_of(PlaceChoice()), "roof");
}

TEST(Place, EveryShippedFileIsReadAndComesBack) {
  const auto names = shipped_names("scenes/placements", ".toml");
  EXPECT_THAT(names, testing::ElementsAre("debris", "kerb", "rear-rack", "road-ahead", "roof", "trailer"));
  for (const std::string& name : names) {
    const PlaceChoice place = place_of_text(name);
    EXPECT_EQ(text_of(place), name);
    const PlaceChoice again = read_place(to_json(place), "run.json", "placed", name);
    EXPECT_EQ(to_json(again), to_json(place));
  }
  EXPECT_EQ(place_of_text("rear-rack").in, PlaceChoice::In::rear);
  EXPECT_EQ(place_of_text("rear-rack").box, TrueBox::grown);
  EXPECT_EQ(place_of_text("road-ahead").victim, Victim::phantom);
  EXPECT_EQ(place_of_text("debris").victim, Victim::object);
  EXPECT_EQ(place_of_text("kerb").victim, Victim::neighbour);
  EXPECT_GT(place_of_text("kerb").within, 0);
}

TEST(Place, AUsersFileCountsByWhatItSays) {
  const test::TemporaryFolder folder;
  const auto file = folder / "mine.toml", other = folder / "other.toml";
  const std::string rack = read_file(shipped_file("scenes/placements/rear-rack.toml"));
  write_file(file, rack);
  EXPECT_EQ(text_of(place_of_text(file.string())), file.string());
  EXPECT_EQ(content_of(place_of_text(file.string())), content_of(place_of_text("rear-rack")));
  write_file(other, std::string(rack).replace(rack.find("-0.5"), 4, "-0.6"));
  EXPECT_NE(content_of(place_of_text(other.string())), content_of(place_of_text("rear-rack")));
}

TEST(Place, WhatAFileCannotSayIsRefusedInALineWithFileAndKey) {
  const test::TemporaryFolder folder;
  const std::string file = (folder / "mine.toml").string();
  struct Case {
    std::string from, to, key, why;
  };
  const std::string kerb = read_file(shipped_file("scenes/placements/kerb.toml"));
  for (const Case& wrong : std::initializer_list<Case>{
           {"yaw = 0", "", "yaw", "missing"},
           {"yaw = 0", "yaw = \"left\"", "yaw", "not a number"},
           {"yaw = 0", "yaw = 0\nmount = \"straps\"", "mount", "unknown"},
           {"\"right\"", "\"rihgt\"", "anchor", "did you mean right?"},
           {"\"right\"", "\"world\"", "anchor", "side"},
           {"\"as labelled\"", "\"larger\"", "box", "grown"},
           {"\"neighbour\"", "\"carrier\"", "within", "remove it"},
           {"within = 12", "", "within", "missing"},
           {"-1.2, 0.12", "-1.2, -0.12", "offset[2]", "under the ground"},
           {"[1.6, 1.2, 1.6]", "[1.6, 1.2]", "volume", "3 numbers"},
           {"[1.6, 1.2, 1.6]", "[1.6, 1.2, 16]", "volume[2]", "out of range"},
           {"-1.2, 0.12", "-0.5, 0.12", "offset", "0.1 m into the host"},
           {"yaw = 0", "yaw = 90\nvolume = [2.6, 1, 1]\n#", "offset", "0.1 m into the host"}}) {
    std::string text = kerb;
    text.replace(text.find(wrong.from), wrong.from.size(), wrong.to);
    if (wrong.to.find("volume") != std::string::npos) {
      const auto second = text.rfind("volume = [1.6");
      text.replace(second, text.find('\n', second) - second, "");
    }
    write_file(file, text);
    const std::string said = test::error_text<InputError>([&] { place_of_text(file); });
    EXPECT_THAT(said, testing::StartsWith(file + ": " + wrong.key + ": ")) << wrong.to;
    EXPECT_THAT(said, HasSubstr(wrong.why)) << wrong.to;
    EXPECT_EQ(said.find('\n'), std::string::npos);
  }
  const std::string absent = test::error_text<FieldError>([&] { place_of_text("/no/such.toml"); });
  EXPECT_THAT(absent, HasSubstr("no such file"));
  EXPECT_THAT(test::error_text<FieldError>([&] { place_of_text("rear-rak"); }),
              HasSubstr("did you mean rear-rack?"));
}

}  // namespace
}  // namespace mirage
