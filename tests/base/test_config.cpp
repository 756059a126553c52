#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "base/config.h"
#include "base/error.h"
#include "base/files.h"
#include "base/plugins.h"
#include "support/files.h"

namespace mirage {
namespace {

using testing::AllOf;
using testing::HasSubstr;

std::string toml_error(const std::string& text) {
  try {
    parse_toml(text, "any.toml");
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

std::string utf8(char32_t point) {
  if (point < 0x800) return {static_cast<char>(0xc0 | point >> 6), static_cast<char>(0x80 | (point & 0x3f))};
  if (point < 0x10000)
    return {static_cast<char>(0xe0 | point >> 12), static_cast<char>(0x80 | (point >> 6 & 0x3f)),
            static_cast<char>(0x80 | (point & 0x3f))};
  return {static_cast<char>(0xf0 | point >> 18), static_cast<char>(0x80 | (point >> 12 & 0x3f)),
          static_cast<char>(0x80 | (point >> 6 & 0x3f)), static_cast<char>(0x80 | (point & 0x3f))};
}

// The ends of every range that toml++ classifies as white space: 0xA0 + k · 0x3FA. A third of them reached
// __builtin_unreachable at a line's start within a string, even in a valid file (asan preset, make fuzz).
TEST(Toml, TakesEveryLetterInStringsAndComments) {
  std::vector<char32_t> letters = {0x80, 0x1f600, 0x10ffff};
  for (char32_t range = 0xa0; range < 0xfeff; range += 0x3fa)
    for (const int step : {0, 1, 0x3f9}) letters.push_back(range + static_cast<char32_t>(step));
  int taken = 0;
  for (const char32_t point : letters) {
    if (point >= 0xd800 && point <= 0xdfff) continue;
    const std::string l = utf8(point);
    const auto read =
        parse_toml("# " + l + "\n\"" + l + "\" = '" + l + "' # " + l + "\n'k" + l + "' = \"x" + l +
                       "\"\nlong = \"\"\"\\\n   " + l + "\\t\"\"\"\"\nraw = '''\n\\" + l + "\"x'y'''''\n",
                   "any.toml");
    EXPECT_EQ(read, (nlohmann::json{
                        {l, l}, {"k" + l, "x" + l}, {"long", l + "\t\""}, {"raw", "\\" + l + "\"x'y''"}}))
        << "U+" << std::hex << static_cast<unsigned>(point);
    ++taken;
  }
  EXPECT_GT(taken, 100);
}

TEST(Toml, RefusesLettersElsewhereInALine) {
  for (const std::string& l : {utf8(0xe9), utf8(0xa0), utf8(0x2003), utf8(0x3001), utf8(0xfb50)}) {
    for (const std::string& text :
         {l + " = 1", "a" + l + " = 1", "a = " + l, "a = 1" + l, "a = 1 " + l, "a = 1" + ("'" + l + "'"),
          "a = [1," + l + "]", "[a" + l + "]", "a = \"x\"" + l, "a = true" + l, "a = \"\\" + l + "\"",
          "a = \"\"\"\\" + l + "\"\"\"", "a = \"\"\"x\\ " + l + "\"\"\"", "a = 'x\n" + l + "'", "a = '" + l,
          "a = '''" + l + "''", "a = \"" + l, "'''" + l + "''' = 1", "a = 1979-05-27" + l}) {
      const std::string said = toml_error("x = 0\n" + text + "\n");
      EXPECT_THAT(said, AllOf(testing::StartsWith("any.toml: line "), HasSubstr("TOML"))) << text;
      EXPECT_EQ(said.find('\n'), std::string::npos) << text;
    }
    EXPECT_THAT(toml_error("\n# " + l + "\nb = 2" + l), HasSubstr("line 3: U+"));
  }
  EXPECT_THAT(toml_error("a = 1\nb = '\xff'"), HasSubstr("line 2: holds bytes that are not UTF-8"));
  EXPECT_THAT(toml_error("# \xed\xa0\x80"), HasSubstr("line 1: holds bytes that are not UTF-8"));
}

TEST(Toml, OfAsciiReachesTheParserAsItIs) {
  const std::string text = "\"a\\\"\" = 'x\\'  # '\nb = '''''' \nc = '\n";
  EXPECT_EQ(toml_in_ascii(text, "any.toml"), text);
  // The same text with a non-ASCII letter: only the quotes of strings change.
  EXPECT_EQ(toml_in_ascii("\xef\xbb\xbf" + text + "#\xc3\xa9", "any.toml"),
            "\"a\\\"\" = \"x\\\\\"  # '\nb = \"\"\"\"\"\" \nc = \"\n#?");
}

TEST(TomlText, ComesBackBitByBit) {
  const nlohmann::json values[] = {
      nlohmann::json::object(),
      {{"c", {true, "x", {{"1e308d", "\n"}, {"two", "a\n\nb\n"}}}}, {"d", "\n\n"}},
      // Keys that need quotes, and texts with every escape.
      {{"a b", 1},
       {"", 2},
       {"\tviw", 3},
       {"a\nb", 4},
       {"a'b", 5},
       {"c.d", {{"\"\x7f", "\t'\"\\\b\f\r\x01\x7f/街"}}}},
      {{"numbers", {1e-320, 0.05, -0.0, 1e308, 1, -7, 0.1, 1.0 / 3, INT64_MIN, INT64_MAX}}},
      {{"infinite", std::numeric_limits<double>::infinity()},
       {"list", {-std::numeric_limits<double>::infinity()}}},
      // Tables in tables and in lists, empty ones, a list of both kinds.
      {{"a", {{"b", {{"c", 1}}}, {"e", nlohmann::json::object()}}},
       {"l", {{{"m", {{{"n", 1}}, {{"n", 2}}}}}, nlohmann::json::object()}},
       {"mixed", {1, {{"k", {1, 2}}}, nlohmann::json::object(), nlohmann::json::array()}}},
      {{"long", std::vector<double>(100, 1.0 / 7)},
       {"words", std::vector<std::string>(9, std::string(60, 'w'))}},
  };
  for (const nlohmann::json& value : values) {
    const std::string text = toml_text(value);
    EXPECT_EQ(parse_toml(text, "written"), value) << text;
  }
  const std::string text = toml_text(values[6]);
  for (std::size_t at = 0, end; at < text.size(); at = end + 1) {
    end = text.find('\n', at);
    EXPECT_LT(end - at, 120u) << text;
  }
  const auto nan = parse_toml(toml_text({{"x", std::nan("")}}), "written");
  EXPECT_TRUE(std::isnan(nan.at("x").get<double>()));
}

using test::error_text;
using test::TemporaryFolder;
using testing::ElementsAre;

TEST(ShippedPlugins, AreWhatTheirDescriptionsSay) {
  const TemporaryFolder folder;
  write_file(folder / "b.json", R"({"kind": "detector", "words": ["one", "two"], "weights": "data"})");
  write_file(folder / "c.json", R"({"kind": "depth", "words": ["three"], "weights": "code"})");
  write_file(folder / "a.json", R"({"kind": "detector", "words": ["four"], "weights": "code"})");
  write_file(folder / "d.json", R"({"kind": "detector", "words": ["five"], "weights": "none"})");
  write_file(folder / "notes.txt", "nothing");
  const auto detectors = read_shipped_plugins(folder.path(), "detector");
  ASSERT_EQ(detectors.size(), 3u);
  EXPECT_EQ(detectors[0].file, folder / "a.so");
  EXPECT_TRUE(detectors[0].weights_are_code);
  EXPECT_THAT(detectors[1].words, ElementsAre("one", "two"));
  EXPECT_FALSE(detectors[1].weights_are_code);
  EXPECT_TRUE(detectors[0].needs_weights && detectors[1].needs_weights);
  EXPECT_FALSE(detectors[2].needs_weights);
  EXPECT_TRUE(detectors[2].weights_are_code);
  EXPECT_EQ(read_shipped_plugins(folder.path(), "depth").size(), 1u);
  EXPECT_TRUE(read_shipped_plugins(folder / "nowhere", "depth").empty());
}

TEST(ShippedPlugins, ADescriptionThatIsNoneIsNamed) {
  const TemporaryFolder folder;
  for (const char* text :
       {"[]", R"({"words": [], "weights": "data"})", R"({"kind": "depth", "weights": "data"})",
        R"({"kind": "depth", "words": [1], "weights": "data"})",
        R"({"kind": "depth", "words": [], "weights": "any"})"}) {
    write_file(folder / "x.json", text);
    EXPECT_THAT(error_text<InputError>([&] { read_shipped_plugins(folder.path(), "depth"); }),
                HasSubstr("x.json"))
        << text;
  }
}

}  // namespace
}  // namespace mirage
