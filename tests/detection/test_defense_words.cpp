#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "base/fields.h"
#include "detection/defense_words.h"
#include "support/files.h"

namespace mirage {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

std::string refusal(const std::string& text) {
  return test::error_text<FieldError>([&] { read_defense(text); });
}

TEST(DefenseWords, WeightsAndWhatStandsAround) {
  for (const char* none : {"", "none"}) {
    EXPECT_EQ(read_defense(none).weights, "");
    EXPECT_THAT(read_defense(none).around, IsEmpty());
  }
  EXPECT_EQ(read_defense("roof-objects").weights, "roof-objects");
  EXPECT_THAT(read_defense("roof-objects").around, IsEmpty());
  EXPECT_THAT(read_defense("shadows").around, ElementsAre("shadows"));
  const Defense all = read_defense("shadows+adversarial+jpeg:50+consistency");
  EXPECT_EQ(all.weights, "adversarial");
  EXPECT_THAT(all.around, ElementsAre("shadows", "jpeg:50", "consistency"));
  EXPECT_TRUE(all.has(kShadows));
  EXPECT_TRUE(all.has(kConsistency));
  EXPECT_FALSE(read_defense("adversarial").has(kShadows));
  const Defense trained = read_defense("ceiling+shadows");
  EXPECT_EQ(trained.weights, "ceiling");
  EXPECT_THAT(trained.around, ElementsAre(kTrainedCeiling, "shadows"));
  EXPECT_EQ(read_defense("ceiling:1.4").weights, "");
}

TEST(DefenseWords, WhatIsNone) {
  for (const char* wrong :
       {"+", "shadows+", "+adversarial", "none+shadows", "Shadows", "../weights", "shadows adversarial"})
    EXPECT_THAT(refusal(wrong), HasSubstr("is no defence")) << wrong;
  EXPECT_THAT(refusal("adversarial+denoising"), HasSubstr("two sets of weights, adversarial and denoising"));
  EXPECT_THAT(refusal("shadows+adversarial+shadows"), HasSubstr("names shadows twice"));
  EXPECT_THAT(refusal("shadows+jpeg:0"), HasSubstr("use jpeg:1 to jpeg:100"));
  for (const char* wrong :
       {"ceiling:", "ceiling:0", "ceiling:-1", "ceiling:1.6m", "ceiling:nan", "ceiling:11"})
    EXPECT_THAT(refusal(wrong), HasSubstr("use metres, such as ceiling:1.6")) << wrong;
  EXPECT_EQ(ceiling_height("ceiling:1.6"), 1.6);
  EXPECT_EQ(ceiling_height("shadows"), 0);
}

}  // namespace
}  // namespace mirage
