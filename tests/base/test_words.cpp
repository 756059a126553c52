#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cstdlib>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/names.h"
#include "base/training_loop.h"
#include "support/files.h"

namespace mirage {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

TEST(Words, SlipsAreCountedAsTheyAreMade) {
  EXPECT_EQ(edit_distance("attack", "attack"), 0);
  EXPECT_EQ(edit_distance("atack", "attack"), 1);    // one letter missing
  EXPECT_EQ(edit_distance("attacck", "attack"), 1);  // one letter too many
  EXPECT_EQ(edit_distance("attaxk", "attack"), 1);   // one letter replaced
  EXPECT_EQ(edit_distance("atatck", "attack"), 1);   // two letters swapped
  EXPECT_EQ(edit_distance("min_veiw", "min-view"), 1);
  EXPECT_EQ(edit_distance("Fusion", "fusion"), 0);
  EXPECT_EQ(edit_distance("", "abc"), 3);
  EXPECT_EQ(edit_distance("kitten", "sitting"), 3);
  EXPECT_EQ(edit_distance("ca", "abc"), 3);  // swapped letters are not edited again: optimal string alignment
}

TEST(Words, OnlyWhatIsNearIsMeant) {
  const std::vector<std::string> known = {"lidar", "camera", "painted", "fusion", "late", "refined"};
  EXPECT_THAT(closest_words("fusoin", known), ElementsAre("fusion"));
  EXPECT_THAT(closest_words("lat", known), ElementsAre("late"));
  EXPECT_THAT(closest_words("pointpillars", known), IsEmpty());
  EXPECT_THAT(closest_words("", known), IsEmpty());
  EXPECT_THAT(closest_words("iter", {"batch", "iterations"}), ElementsAre("iterations"));
  EXPECT_THAT(closest_words("kitti", {"nuscenes", "kitti64", "xenith"}), ElementsAre("kitti64"));
  EXPECT_THAT(closest_words("frame", {"frame-rate", "farm", "frames"}), ElementsAre("frames", "frame-rate"));
  EXPECT_THAT(closest_words("a", {"b"}), IsEmpty());
}

TEST(Words, AllThatThereIsIsNamedTheNearestFirst) {
  EXPECT_EQ(use_one_of("visibel", {"plain", "visible"}), "did you mean visible? use visible or plain");
  EXPECT_EQ(use_one_of("armour", {"adversarial", "denoising"}, "a file"),
            "use adversarial, denoising or a file");
  const FieldError error = unknown_word("light", "visibel", {"plain", "visible"});
  EXPECT_STREQ(error.what(), "light: visibel: unknown; did you mean visible? use visible or plain");
  std::vector<std::string> many;
  for (int i = 0; i < 150; ++i) many.push_back("word-" + std::to_string(i));
  const std::string all = unknown_word("setting", "nothing", many).what();
  for (const std::string& word : many) EXPECT_THAT(all, HasSubstr(word));
}

TEST(Words, ShippedFilesAreTheirFoldersOwn) {
  test::TemporaryFolder folder;
  write_file(folder / "scenes/rigs/one.toml", "");
  write_file(folder / "scenes/rigs/other.toml", "");
  write_file(folder / "scenes/rigs/notes.txt", "");
  setenv("MIRAGE_HOME", folder.path().c_str(), 1);
  EXPECT_THAT(shipped_names("scenes/rigs", ".toml"), ElementsAre("one", "other"));
  EXPECT_EQ(shipped_choice("scenes/rigs", ".toml", "one", "rig"), folder / "scenes/rigs/one.toml");
  EXPECT_THAT(test::error_text<FieldError>([] { shipped_choice("scenes/rigs", ".toml", "onne", "rig"); }),
              HasSubstr("did you mean one? use one or other"));
  EXPECT_THAT(shipped_names("scenes/no-such-folder", ".toml"), IsEmpty());
  EXPECT_THAT(
      test::error_text<InputError>([] { shipped_choice("scenes/no-such-folder", ".toml", "one", "rig"); }),
      HasSubstr("MIRAGE_HOME"));
  unsetenv("MIRAGE_HOME");
}

TEST(Words, RangesHaveOneNotation) {
  EXPECT_EQ(Range{}.words(), "a number");
  EXPECT_EQ(kPositive.words(), "above 0");
  EXPECT_EQ((Range{kPositive.low, 10}).words(), "above 0, at most 10");
  EXPECT_EQ(kNotNegative.words(), "at least 0");
  EXPECT_EQ((Range{0, 1024}).words(), "0 to 1024");
  EXPECT_EQ((Range{1e-4, 1 << 20}).words(), "0.0001 to 1048576");
  EXPECT_EQ((Range{-Range::kMax, 3}).words(), "at most 3");
}

using test::error_text;
using test::TemporaryFolder;
using testing::AllOf;

TEST(Names, BytesThatAreNoTextAreEscapedAndTheRestStays) {
  EXPECT_EQ(printable("000008"), "000008");
  EXPECT_EQ(printable("Straße/街/🚗"), "Straße/街/🚗");
  EXPECT_EQ(printable("a\xff"
                      "b\xc3"),
            "a\\xffb\\xc3");
  EXPECT_EQ(printable("\x1b[31m\n\x7f"), "\\x1b[31m\\x0a\\x7f");
  EXPECT_EQ(printable("\xc2\x9b"
                      "2J"),
            "\\xc2\\x9b2J");                                // C1: a terminal's escape in one character
  EXPECT_EQ(printable("\xc0\xaf"), "\\xc0\\xaf");           // overlong '/'
  EXPECT_EQ(printable("\xed\xa0\x80"), "\\xed\\xa0\\x80");  // a surrogate
  EXPECT_EQ(printable("\xf4\x90\x80\x80"), "\\xf4\\x90\\x80\\x80");  // beyond the last code point
  EXPECT_EQ(printable("a\\b"), "a\\b");
}

TEST(Errors, SayThatANameIsEmpty) {
  EXPECT_STREQ(InputError("", "run.json", "missing", "give a run").what(),
               "\"\": run.json: missing; give a run");
}

TEST(Errors, AreOneLineWhateverTheyQuote) {
  EXPECT_STREQ(InputError("a\nb.json", "\x1b[2J", "\"\r\xff\" is\nno word", "mend it").what(),
               "a\\x0ab.json: \\x1b[2J: \"\\x0d\\xff\" is no word; mend it");
  EXPECT_STREQ(Failure("disk", "full\nof it", "make room").what(), "disk: full of it; make room");
  // Long texts keep both ends and whole characters.
  std::string street;
  for (int i = 0; i < 1000; ++i) street += "街";
  const std::string said = InputError(street, "x" + street + "y", street, street).what();
  EXPECT_LT(said.size(), 6100u);
  EXPECT_EQ(printable(said), said);
  EXPECT_THAT(said, AllOf(HasSubstr(": x街"), HasSubstr("…"), HasSubstr("街y: 街"), testing::EndsWith("街")));
  const std::string file = "/" + std::string(4000, 'd');
  EXPECT_THAT(InputError(file, "", "is missing", "make it").what(), HasSubstr(file + ": is missing"));
}

TEST(Names, EscapedNamesComeBack) {
  std::string all;
  for (int c = 1; c < 256; ++c) all += static_cast<char>(c);
  for (const std::string& name : {std::string("000008"), std::string("a\\xffb"), std::string("a\xff\\\\x41"),
                                  std::string("\\"), std::string("街\xe8"), all}) {
    EXPECT_EQ(unescape_name(escape_name(name)), name);
    EXPECT_NO_THROW(nlohmann::json(escape_name(name)).dump());
  }
  EXPECT_EQ(unescape_name("\\xZZ\\x4"), "\\xZZ\\x4");
}

TEST(Names, FrameIdsAreNamesOfFiles) {
  for (const char* good : {"000008", "drive 9 (2)", "\xff", "...", "a\\b"})
    EXPECT_EQ(frame_id_problem(good), "") << good;
  for (const std::string& bad :
       {std::string(), std::string("."), std::string(".."), std::string("../up"), std::string("/etc/passwd"),
        std::string("a\0b", 3), std::string(200, 'x'), std::string(60, '\xff')})
    EXPECT_NE(frame_id_problem(bad), "") << bad;
}

TEST(Names, JsonIsWrittenWhateverTheNames) {
  TemporaryFolder folder;
  write_json(folder / "a.json", {{"out\xff", {"x\xfe", 1.5, {{"k", "\x80"}}}}});
  const auto back = read_json(folder / "a.json");
  EXPECT_EQ(back.at("out\\xff").at(0), "x\\xfe");
  EXPECT_EQ(back.at("out\\xff").at(2).at("k"), "\\x80");
}

TEST(ReadJson, RefusesWhatNoFileOfOursHolds) {
  TemporaryFolder folder;
  write_file(folder / "deep.json", std::string(100000, '[') + std::string(100000, ']'));
  EXPECT_THAT(error_text<InputError>([&] { read_json(folder / "deep.json"); }),
              AllOf(HasSubstr("deep.json"), HasSubstr("nested deeper")));
  write_file(folder / "text.json", "{\"a\": \"" + std::string(200, '[') + "\\\"\"}");
  EXPECT_NO_THROW(read_json(folder / "text.json"));
  write_file(folder / "large.json", "{\"a\": 1e999}");
  EXPECT_THAT(error_text<InputError>([&] { read_json(folder / "large.json"); }), HasSubstr("out of range"));
  ASSERT_EQ(mkfifo((folder / "pipe.json").c_str(), 0600), 0);
  EXPECT_THAT(error_text<InputError>([&] { read_json(folder / "pipe.json"); }),
              HasSubstr("not a regular file"));
}

TEST(JsonFields, EachErrorNamesFileAndField) {
  const nlohmann::json json = {{"n", 3},         {"x", 0.5},           {"t", "text"},
                               {"list", {1, 2}}, {"huge", 1e300},      {"minus", -1},
                               {"yes", true},    {"in", {{"a", "b"}}}, {"most", UINT64_MAX}};
  const JsonFields fields("f.json", json, "mend it");
  EXPECT_EQ(fields.integer("n", 0, 3), 3);
  EXPECT_EQ(fields.number("x", 0, 1), 0.5);
  EXPECT_EQ(fields.counter("most"), UINT64_MAX);
  EXPECT_EQ(fields.numbers("list", 2, 0, 5), (std::vector<double>{1, 2}));
  EXPECT_EQ(fields.object("in").text("a"), "b");
  EXPECT_TRUE(fields.truth("yes"));
  const auto text = [](const auto& read) { return error_text<InputError>(read); };
  EXPECT_EQ(text([&] { fields.integer("none", 0, 1); }), "f.json: none: missing; mend it");
  EXPECT_THAT(text([&] { fields.integer("x", 0, 1); }), HasSubstr("x: not a whole number"));
  EXPECT_THAT(text([&] { fields.integer("huge", 0, 1); }), HasSubstr("huge: not a whole number"));
  EXPECT_THAT(text([&] { fields.integer("most", 0, 9); }),
              HasSubstr("18446744073709551615 is out of range, 0 to 9"));
  EXPECT_THAT(text([&] { fields.integer("minus", 0, 9); }), HasSubstr("-1 is out of range, 0 to 9"));
  EXPECT_THAT(text([&] { fields.counter("minus"); }), HasSubstr("minus: not a whole number from 0"));
  EXPECT_THAT(text([&] { fields.number("t", 0, 1); }), HasSubstr("t: not a number"));
  EXPECT_THAT(text([&] { fields.numbers("list", 3, 0, 1); }), HasSubstr("not a list of 3 numbers"));
  EXPECT_THAT(text([&] { fields.numbers("list", 2, 0, 1); }),
              HasSubstr("list[1]: 2 is out of range, 0 to 1"));
  EXPECT_THAT(text([&] { fields.object("in").text("b"); }), HasSubstr("f.json: in.b: missing"));
  EXPECT_THAT(text([&] { fields.object("n"); }), HasSubstr("f.json: n: not a JSON object"));
  EXPECT_THAT(text([&] { JsonFields("f.json", nlohmann::json::array(), "mend it"); }),
              HasSubstr("f.json: not a JSON object"));
}

// A state's weights are removed once those of the next state are written.
TEST(TrainingState, NamesNoFileButItsOwnWeights) {
  TemporaryFolder folder;
  const nlohmann::json wanted = {{"steps", 9}};
  TrainingState state;
  state.step = 3;
  write_training_state(folder.path(), wanted, state, [](const auto& file) { write_file(file, "w"); });
  EXPECT_EQ(read_training_state(folder.path(), wanted).weights, folder / "checkpoint-3.weights");
  const auto good = read_json(folder / "training.json");
  const auto with = [&](const char* key, const nlohmann::json& value) {
    auto changed = good;
    changed[key] = value;
    write_json(folder / "training.json", changed);
    return error_text<InputError>([&] { read_training_state(folder.path(), wanted); });
  };
  EXPECT_THAT(with("weights", "../precious"), HasSubstr("training.json: weights"));
  EXPECT_THAT(with("weights", "/etc/passwd"), HasSubstr("training.json: weights"));
  EXPECT_THAT(with("step", -1), HasSubstr("training.json: step"));
  EXPECT_THAT(with("step", 1000000000000), HasSubstr("training.json: step"));
  EXPECT_THAT(with("seconds", "long"), HasSubstr("training.json: seconds"));
  EXPECT_THAT(with("losses", {1, 2}), HasSubstr("training.json: losses"));
  EXPECT_THAT(with("options", 1), HasSubstr("training.json: options"));
}

}  // namespace
}  // namespace mirage
