// The camera network: its gradient, where its boxes lie, what it is taught, and what it starts from.
#include <gtest/gtest.h>
#include <torch/script.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>

#include "camera.h"
#include "camera_loss.h"
#include "tensor_checks.h"

namespace mirage::fusion {
namespace {

using test::check;
using test::tensor_of;
using torch::Tensor;

/// A network whose answers differ from place to place. (At birth the last layers are almost silent.)
CameraNet lively() {
  torch::manual_seed(21);
  CameraNet network;
  network->to(torch::kDouble);
  return network;
}

Tensor picture_of(int height, int width) {
  torch::manual_seed(22);
  return torch::rand({height, width, 3}, torch::kDouble) * 0.9 + 0.05;
}

TEST(CameraNet, GradientOfEveryOutputMatchesDifferences) {
  CameraNet network = lively();
  const Tensor picture = picture_of(36, 70);
  const auto weighed = [](const Tensor& x) {
    return (x * torch::cos(torch::arange(x.numel(), torch::kDouble)).view(x.sizes())).sum();
  };
  for (int output = 0; output < 4; ++output) {
    const auto scalar = [&](const Tensor& x) {
      const CameraOutput seen = network(x);
      return weighed(output == 0   ? seen.features
                     : output == 1 ? seen.mask
                     : output == 2 ? seen.boxes
                                   : seen.logits);
    };
    check(picture, scalar, 1e-6, 1e-4, [](std::size_t i) { return i % 211 == 0; });
  }
}

TEST(CameraNet, DarkAndSaturatedPicturesGiveFiniteGradients) {
  CameraNet network = lively();
  for (const double value : {0.0, 0.0031308, 1.0}) {
    const Tensor picture = torch::full({33, 40, 3}, value, torch::kDouble).requires_grad_(true);
    const CameraOutput seen = network(picture);
    const Tensor gradient = torch::autograd::grad({seen.logits.sum() + seen.mask.sum()}, {picture})[0];
    EXPECT_TRUE(torch::isfinite(gradient).all().item<bool>()) << value;
  }
}

TEST(CameraNet, TakesPicturesOfAnySizeAndCountsItsPlaces) {
  CameraNet network;
  const torch::NoGradGuard guard;
  for (const auto& [width, height] : {std::pair{1, 1}, {33, 31}, {320, 95}}) {
    const CameraOutput seen = network(torch::rand({height, width, 3}));
    const std::vector<Place> places = places_of(height, width);
    EXPECT_EQ(seen.boxes.size(0), static_cast<std::int64_t>(places.size()));
    EXPECT_EQ(seen.mask.size(2) * kMaskStride, seen.features.size(2) * kFeatureStride);
    EXPECT_TRUE(torch::isfinite(seen.boxes).all().item<bool>());
  }
  // Of 8 × 8 pixels: the first place's middle lies between the pixels 3 and 4.
  EXPECT_FLOAT_EQ(places_of(64, 64).front().x, 3.5f);
}

TEST(CameraNet, AVoiceMovesByTheShiftOfAPlace) {
  // Convolutions know no place: the picture one stride of 32 to the right gives the boxes there.
  CameraNet network = lively();
  const torch::NoGradGuard guard;
  const Tensor picture = torch::full({96, 256, 3}, 0.4, torch::kDouble);
  Tensor left = picture.clone(), right = picture.clone();
  const Tensor thing = picture_of(24, 24);
  left.narrow(0, 36, 24).narrow(1, 96, 24).copy_(thing);
  right.narrow(0, 36, 24).narrow(1, 128, 24).copy_(thing);
  const CameraOutput a = network(left), b = network(right);
  const Tensor map_a = a.logits.narrow(0, 0, 12 * 32).view({12, 32}),
               map_b = b.logits.narrow(0, 0, 12 * 32).view({12, 32});
  const Tensor near_a = map_a.narrow(1, 11, 6), near_b = map_b.narrow(1, 15, 6);
  EXPECT_LT((near_a - near_b).abs().max().item<double>(),
            0.2 * (near_a - map_a[0][31]).abs().max().item<double>());
  const Tensor boxes_a = a.boxes.narrow(0, 6 * 32 + 13, 1), boxes_b = b.boxes.narrow(0, 6 * 32 + 17, 1);
  EXPECT_NEAR((boxes_b - boxes_a)[0][0].item<double>(), 32, 2);
}

TEST(CameraNet, TheProductsLogitNeverOverflows) {
  const Tensor a = tensor_of({-500, 500, 0, 2, -3}, {5}), b = tensor_of({500, 500, 0, -1, -4}, {5});
  const Tensor logit = logit_of_product(a, b);
  EXPECT_TRUE(torch::isfinite(logit).all().item<bool>());
  for (int i = 2; i < 5; ++i) {
    const double p = (torch::sigmoid(a[i]) * torch::sigmoid(b[i])).item<double>();
    EXPECT_NEAR(logit[i].item<double>(), std::log(p / (1 - p)), 1e-9);
  }
  check(a, [&](const Tensor& x) { return logit_of_product(x, b).narrow(0, 2, 3).sum(); });
}

TEST(CameraLoss, APlaceAnswersForTheBoxItLiesIn) {
  const std::vector<Place> places = places_of(96, 160);
  std::vector<float> boxes(4 * places.size()), logits(places.size(), -4);
  for (std::size_t p = 0; p < places.size(); ++p) {
    const auto [x, y, stride] = places[p];
    const std::array<float, 4> own = {x - 2 * stride, y - stride, x + 2 * stride, y + stride};
    std::copy(own.begin(), own.end(), boxes.begin() + static_cast<std::ptrdiff_t>(4 * p));
  }
  const MiragePictureBox car{40, 30, 80, 50}, ignored{100, 60, 140, 90};
  const PictureMatch matched = match(places, boxes, logits, std::array{car}, std::array{ignored}, 96, 150);
  ASSERT_FALSE(matched.places.empty());
  for (const std::int64_t p : matched.places) {
    EXPECT_NEAR(places[p].x, 60, 2.5 * places[p].stride);
    EXPECT_NEAR(places[p].y, 40, 2.5 * places[p].stride);
  }
  for (const std::int64_t p : matched.silent)
    EXPECT_TRUE(places[p].x > 150 || (places[p].x > 100 && places[p].x < 140 && places[p].y > 60)) << p;
  EXPECT_FALSE(matched.silent.empty());
  // A box that no place's centre lies in has its nearest places.
  const MiragePictureBox thin{60.1f, 40.1f, 60.9f, 40.4f};
  EXPECT_FALSE(match(places, boxes, logits, std::array{thin}, {}, 96, 160).places.empty());
}

TEST(CameraLoss, GradientOfTheOverlapMatchesDifferences) {
  const Tensor b = tensor_of({0, 0, 10, 10, 3, 3, 9, 8, 50, 50, 60, 60}, {3, 4});
  const Tensor a = tensor_of({2, 1, 12, 9, 3.5, 2, 8, 9, 0, 0, 5, 5}, {3, 4});
  check(a, [&](const Tensor& x) { return row_iou(x, b).sum(); });
  EXPECT_NEAR(row_iou(a, b)[0].item<double>(), 64.0 / (100 + 80 - 64), 1e-12);
  EXPECT_EQ(row_iou(a, b)[2].item<double>(), 0);
  const Tensor flat = tensor_of({5, 5, 5, 5}, {1, 4}).requires_grad_(true);
  EXPECT_TRUE(torch::isfinite(torch::autograd::grad({row_iou(flat, flat.detach()).sum()}, {flat})[0])
                  .all()
                  .item<bool>());
}

TEST(CameraLoss, TeachesWhatIsLabelledAndNothingOfWhatIsIgnored) {
  torch::manual_seed(23);
  CameraNet network;
  Tensor picture = torch::full({64, 96, 3}, 0.3);
  picture.narrow(0, 20, 24).narrow(1, 30, 40).fill_(0.9);
  const MiragePictureBox car{30, 20, 70, 44};
  std::vector<std::uint8_t> mask(64 * 96, 0);
  for (int v = 20; v < 44; ++v)
    for (int u = 30; u < 70; ++u) mask[static_cast<std::size_t>(v) * 96 + u] = 1;
  torch::optim::Adam optimiser(network->parameters(), 3e-3);
  double first = 0, last = 0;
  for (int step = 0; step < 40; ++step) {
    optimiser.zero_grad();
    const LossTerms loss = picture_loss(network(picture), std::array{car}, {}, mask.data(), 64, 96);
    loss.total.backward();
    optimiser.step();
    (step == 0 ? first : last) = loss.total.item<double>();
  }
  EXPECT_LT(last, 0.4 * first);
  const torch::NoGradGuard guard;
  const CameraOutput seen = network(picture);
  const std::int64_t best = seen.logits.argmax().item<std::int64_t>();
  EXPECT_GT(
      row_iou(seen.boxes.narrow(0, best, 1), torch::tensor({{30.f, 20.f, 70.f, 44.f}}))[0].item<float>(),
      0.5);
  EXPECT_GT(seen.mask[0][0][8][12].item<float>(), seen.mask[0][0][2][2].item<float>());
  // The same thing under a region that is ignored costs nothing where it is.
  const double silent = picture_loss(seen, {}, std::array{MiragePictureBox{0, 0, 96, 64}}, nullptr, 64, 96)
                            .total.item<double>(),
               spoken = picture_loss(seen, {}, {}, nullptr, 64, 96).total.item<double>();
  EXPECT_LT(silent, 1e-6);
  EXPECT_GT(spoken, 1e-3);
}

TEST(CameraNet, RefusesFilesThatAreNotItsNetwork) {
  const auto file =
      std::filesystem::temp_directory_path() / ("mirage_coco_" + std::to_string(getpid()) + ".pt");
  CameraNet network;
  EXPECT_THROW(read_coco(*network, file.string()), std::runtime_error);
  torch::jit::Module other("Other");
  other.register_parameter("weight", torch::ones({3, 4}), false);
  other.save(file.string());
  EXPECT_THROW(read_coco(*network, file.string()), std::runtime_error);
  std::filesystem::remove(file);
}

TEST(CameraNet, TakesOverANetworkOfItsShape) {
  // COCO's order of layers is ours without the mask's; its class layers have 80 rows, of which row 2 is
  // "car".
  const auto file =
      std::filesystem::temp_directory_path() / ("mirage_like_" + std::to_string(getpid()) + ".pt");
  torch::manual_seed(24);
  CameraNet from, into;
  torch::jit::Module coco("Coco");
  int number = 0;
  for (const auto& item : from->named_parameters()) {
    if (item.key().starts_with("mask_")) continue;
    Tensor value = item.value().detach().clone();
    if (item.key().find("class_out") != std::string::npos) {
      auto shape = value.sizes().vec();
      shape[0] = 80;
      Tensor all = torch::full(shape, 7.f);
      all.narrow(0, 2, 1).copy_(value);
      value = all;
    }
    coco.register_parameter("c" + std::to_string(number++), value, false);
  }
  coco.save(file.string());
  read_coco(*into, file.string());
  auto ours = into->named_parameters();
  for (const auto& item : from->named_parameters())
    if (item.value().dim() == 4) {  // biases may be born alike
      EXPECT_EQ(torch::equal(ours[item.key()], item.value()), !item.key().starts_with("mask_")) << item.key();
    }
  std::filesystem::remove(file);
}

}  // namespace
}  // namespace mirage::fusion
