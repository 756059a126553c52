#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "base/error.h"
#include "base/json_depth.h"
#include "support/files.h"

namespace mirage {
namespace {

using test::error_text;
using testing::AllOf;
using testing::HasSubstr;

TEST(JsonDepth, CountsArraysAndObjectsButNoTexts) {
  const auto nested = [](int levels) { return std::string(static_cast<std::size_t>(levels), '['); };
  check_json_depth(nested(kDeepestJson), "a.json");
  EXPECT_THAT(error_text<InputError>([&] { check_json_depth(nested(kDeepestJson + 1), "a.json", "JSON"); }),
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

}  // namespace
}  // namespace mirage
