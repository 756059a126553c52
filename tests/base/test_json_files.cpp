#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <fstream>

#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/sizes.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using testing::AllOf;
using testing::HasSubstr;

TEST(JsonDepth, CountsArraysAndObjectsButNoTexts) {
  const auto nested = [](int levels) { return std::string(as_size(levels), '['); };
  check_json_depth(nested(kMaxJsonDepth), "a.json");
  EXPECT_THAT(error_text<InputError>([&] { check_json_depth(nested(kMaxJsonDepth + 1), "a.json", "JSON"); }),
              AllOf(HasSubstr("a.json: JSON"), HasSubstr("byte 128"), HasSubstr("128 levels")));
  std::string wide = "[";
  for (int i = 0; i < 1000; ++i) wide += "[{}],";
  check_json_depth(wide, "a.json");
  check_json_depth("{\"" + nested(1000) + "\\\"" + nested(1000) + "\": \"\\\\\"}", "a.json");
  EXPECT_THROW(check_json_depth("{\"\\\\\":" + nested(1000), "a.json"), InputError);
}

TEST(JsonValues, CountsKeysAndListsButNoTexts) {
  const std::string text = R"({"a": [1, 2, "[,,:{"], "b": {}})";  // 7 values and 2 keys
  check_json_values(text, "a.json", 9);
  EXPECT_THAT(error_text<InputError>([&] { check_json_values(text, "a.json", 8); }),
              AllOf(HasSubstr("a.json"), HasSubstr("more than 8 values")));
  check_json_values(text, "a.json", 9, 3);
  EXPECT_THAT(error_text<InputError>([&] { check_json_values(text, "a.json", 9, 2); }),
              HasSubstr("more than 2 lists"));
}

using test::TemporaryFolder;
using testing::ElementsAre;

class JsonRows : public testing::Test {
 protected:
  using json = nlohmann::json;

  std::vector<json> rows_of(const std::string& text, const std::string& list = "",
                            std::size_t longest = kMaxRowBytes) {
    write_file(folder_ / "rows.json", text);
    std::vector<json> rows;
    for_each_json_row(
        folder_ / "rows.json", list, "restore it",
        [&](std::size_t i, const json& row) {
          EXPECT_EQ(i, rows.size());
          rows.push_back(row);
        },
        longest);
    return rows;
  }
  std::string refusal(const std::string& text, const std::string& list = "",
                      std::size_t longest = kMaxRowBytes) {
    return error_text<InputError>([&] { rows_of(text, list, longest); });
  }
  TemporaryFolder folder_;
};

TEST_F(JsonRows, AreThoseOfTheWholeFile) {
  const json all = {1, "two", {{"three", {3, json::object()}}}, {4, {5}}, nullptr, json::object()};
  for (const int indent : {-1, 2}) {
    EXPECT_EQ(rows_of(all.dump(indent)), all.get<std::vector<json>>());
    const json beside = {{"a", {{"rows", {7}}}}, {"rows", all}, {"z", {{{"rows", {8}}}, {9}}}};
    EXPECT_EQ(rows_of(beside.dump(indent), "rows"), all.get<std::vector<json>>());
  }
  EXPECT_TRUE(rows_of("[]").empty());
  EXPECT_TRUE(rows_of("{\"rows\": []}", "rows").empty());
}

TEST_F(JsonRows, WhatIsNoListOrNoJsonIsNamed) {
  for (const char* text : {"{}", "{\"rows\": [1]}", "3", "\"[]\"", "null"})
    EXPECT_THAT(refusal(text), AllOf(HasSubstr("rows.json"), HasSubstr("is not a list of rows; restore it")));
  EXPECT_THAT(refusal("{\"other\": [1]}", "rows"), HasSubstr("rows: is missing"));
  EXPECT_THAT(refusal("{\"a\": {\"rows\": [1]}}", "rows"), HasSubstr("rows: is missing"));
  for (const char* text : {"[1]", "{\"rows\": 3}", "{\"rows\": {\"a\": [1]}}"})
    EXPECT_THAT(refusal(text, "rows"), HasSubstr("rows: is not a list"));
  EXPECT_THAT(refusal("{\"rows\": [1], \"rows\": [2]}", "rows"), HasSubstr("rows: is there twice"));
  EXPECT_THAT(refusal(""), HasSubstr("byte 1: not valid JSON"));
  EXPECT_THAT(refusal("[1, 2"), HasSubstr("not valid JSON"));
  EXPECT_THAT(refusal("[1] 2"), HasSubstr("not valid JSON"));
  EXPECT_THAT(refusal("[1e999]"), HasSubstr("out of range"));
  EXPECT_THAT(refusal(std::string(kMaxJsonDepth + 2, '[')), HasSubstr("nested deeper"));
}

TEST_F(JsonRows, RowsBeforeAFaultAreVisited) {
  std::vector<json> seen;
  write_file(folder_ / "rows.json", "[1, 2, }");
  EXPECT_THROW(for_each_json_row(folder_ / "rows.json", "", "",
                                 [&](std::size_t, const json& row) { seen.push_back(row); }),
               InputError);
  EXPECT_THAT(seen, ElementsAre(1, 2));
}

TEST_F(JsonRows, NothingBetweenTwoRowsIsLong) {
  const std::string letters(300, 'x'), blanks(300, ' '), few(150, ' ');
  const auto refused = [&](const std::string& text, const std::string& list = "") {
    EXPECT_THAT(refusal(text, list, 200), HasSubstr("a row of more than 200 bytes")) << text;
  };
  refused(fmt::format("[\"{}\"]", letters));
  refused(fmt::format("[1,{}2]", blanks));
  refused(fmt::format("{{\"a\": \"{}\", \"rows\": []}}", letters), "rows");
  json many;
  for (int i = 0; i < 300; ++i) many[fmt::format("k{}", i)] = i;  // members of another object are not rows
  refused(json{{"a", many}, {"rows", {1}}}.dump(), "rows");
  EXPECT_EQ(rows_of(fmt::format("[{}1,{}2]", few, few), "", 200).size(), 2u);
}

// 40 MB of rows that would be 1 GB of values.
TEST_F(JsonRows, TakeTheMemoryOfOne) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "a sanitizer keeps what was freed";
#endif
  {
    std::ofstream file(folder_ / "many.json");
    file << "[{\"a\": [[]";
    std::string row;
    for (int i = 0; i < 100; ++i) row += ",[]";
    row += "]}";
    for (int i = 0; i < 130000; ++i) file << row << ",{\"a\": [[]";
    file << "]}]";
  }
  const auto peak = [] {
    rusage use{};
    getrusage(RUSAGE_SELF, &use);
    return use.ru_maxrss;  // KB
  };
  const long before = peak();
  std::size_t count = 0;
  for_each_json_row(folder_ / "many.json", "", "", [&](std::size_t, const json&) { ++count; });
  EXPECT_EQ(count, 130001u);
  EXPECT_LT(peak() - before, 20'000);
}

}  // namespace
}  // namespace mirage
