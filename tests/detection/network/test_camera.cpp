// The camera network: its gradient, box positions, training targets and start weights.
#include <gtest/gtest.h>
#include <torch/script.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <vector>

#include "augment.h"
#include "base/sizes.h"
#include "camera.h"
#include "fusion_detector.h"
#include "loss.h"
#include "tensor_checks.h"
#include "weights.h"

namespace mirage::fusion {
namespace {

using test::check;
using test::tensor_of;
using torch::Tensor;

/// A network whose answers differ from place to place. (After initialisation the last layers give almost 0.)
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
    check(picture, scalar, 1e-5, 1e-4, [](std::size_t i) { return i % 211 == 0; });
  }
}

TEST(CameraNet, TheGradientOfTheBoxesIsTheSameInFloat) {
  // In float, inputs are not copied into the graph: tensors that it keeps must outlive the forward pass.
  const Tensor picture = picture_of(36, 70);
  const auto gradient = [&](torch::ScalarType type) {
    CameraNet network = lively();
    network->to(type);
    const Tensor x = picture.to(type).clone().requires_grad_(true);
    const Tensor boxes = network(x).boxes;
    const Tensor churn = torch::full({1 << 16}, 1e9f);  // overwrites freed memory of the heap
    const Tensor weights = torch::cos(torch::arange(boxes.numel(), type)).view(boxes.sizes());
    return torch::autograd::grad({(boxes * weights).sum()}, {x})[0].to(torch::kDouble);
  };
  const Tensor exact = gradient(torch::kDouble);
  EXPECT_LT((gradient(torch::kFloat) - exact).norm().item<double>(), 1e-2 * exact.norm().item<double>());
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
  // Of 8 × 8 pixels: the first place's centre lies between the pixels 3 and 4.
  EXPECT_FLOAT_EQ(places_of(64, 64).front().x, 3.5f);
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
    EXPECT_NEAR(places[as_size(p)].x, 60, 2.5 * places[as_size(p)].stride);
    EXPECT_NEAR(places[as_size(p)].y, 40, 2.5 * places[as_size(p)].stride);
  }
  for (const std::int64_t p : matched.silent)
    EXPECT_TRUE(places[as_size(p)].x > 150 ||
                (places[as_size(p)].x > 100 && places[as_size(p)].x < 140 && places[as_size(p)].y > 60))
        << p;
  EXPECT_FALSE(matched.silent.empty());
  // A box without the centre of any place gets its nearest places.
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

/// An untrained network's output for a picture of 64 × 96 pixels.
CameraOutput untaught() {
  torch::manual_seed(23);
  CameraOutput said;
  std::vector<float> boxes;
  for (const auto& [x, y, stride] : places_of(64, 96))
    boxes.insert(boxes.end(), {x - stride, y - stride / 2, x + stride, y + stride / 2});
  said.boxes = torch::tensor(boxes).view({-1, 4});
  said.logits = torch::randn({said.boxes.size(0)}) - 4;
  said.mask = torch::randn({1, 1, 16, 24});
  return said;
}

TEST(CameraLoss, TeachesWhatIsLabelledAndNothingOfWhatIsIgnored) {
  const MiragePictureBox car{30, 20, 70, 44};
  std::vector<std::uint8_t> mask(64 * 96, 0);
  for (int v = 20; v < 44; ++v)
    for (int u = 30; u < 70; ++u) mask[as_size(v) * 96 + as_size(u)] = 1;
  CameraOutput said = untaught();
  std::vector<Tensor> outputs = {said.boxes, said.logits, said.mask};
  for (Tensor& output : outputs) output.requires_grad_(true);
  torch::optim::Adam boxes({said.boxes}, 0.5), scores({said.logits, said.mask}, 0.1);
  double first = 0, last = 0;
  for (int step = 0; step < 150; ++step) {
    boxes.zero_grad(), scores.zero_grad();
    const LossTerms loss = picture_loss(said, std::array{car}, {}, mask.data(), 64, 96);
    loss.total.backward();
    boxes.step(), scores.step();
    (step == 0 ? first : last) = loss.total.item<double>();
  }
  EXPECT_LT(last, 0.2 * first);
  const torch::NoGradGuard guard;
  const std::int64_t best = said.logits.argmax().item<std::int64_t>();
  EXPECT_GT(
      row_iou(said.boxes.narrow(0, best, 1), torch::tensor({{30.f, 20.f, 70.f, 44.f}}))[0].item<float>(),
      0.8);
  EXPECT_GT(said.mask[0][0][8][12].item<float>(), 0);
  EXPECT_LT(said.mask[0][0][2][2].item<float>(), 0);
  // Under an ignored region nothing adds to the loss; without it, outputs there do.
  const auto cost = [&](std::span<const MiragePictureBox> ignored) {
    return picture_loss(said, {}, ignored, nullptr, 64, 96).total.item<double>();
  };
  EXPECT_LT(cost(std::array{MiragePictureBox{0, 0, 96, 64}}), 1e-6);
  EXPECT_GT(cost({}), 0.5);
}

TEST(CameraLoss, GradientMatchesDifferences) {
  const MiragePictureBox car{30, 20, 70, 44};
  const CameraOutput said = untaught();
  std::vector<std::uint8_t> mask(64 * 96, 0);
  std::fill_n(mask.begin(), 96 * 20, std::uint8_t{1});
  const auto loss = [&](const Tensor& boxes, const Tensor& logits, const Tensor& seen) {
    CameraOutput now;
    // The match is made of floats, as in training; the loss is in double here.
    now.boxes = boxes.to(torch::kFloat), now.logits = logits.to(torch::kFloat);
    now.mask = seen.to(torch::kFloat);
    return picture_loss(now, std::array{car}, {}, mask.data(), 64, 96).total.to(torch::kDouble);
  };
  // The target of a score is the IoU that its box reaches, a constant: boxes are not checked through it.
  const auto wide = [](const Tensor& x) { return x.to(torch::kDouble); };
  check(
      wide(said.logits), [&](const Tensor& x) { return loss(said.boxes, x, said.mask); }, 1e-2, 2e-2,
      [](std::size_t i) { return i % 17 == 0; });
}

/// Left, top, right and bottom of the pixels above one half, in a picture or a mask.
std::vector<std::int64_t> bright(const Tensor& plane) {
  const Tensor rows = (plane > 0.5).any(1).nonzero(), columns = (plane > 0.5).any(0).nonzero();
  return {columns.min().item<std::int64_t>(), rows.min().item<std::int64_t>(),
          columns.max().item<std::int64_t>(), rows.max().item<std::int64_t>()};
}

TEST(MovedPicture, BoxesAndMaskGoWithTheirPixels) {
  // An off-centre white rectangle, so that a flip or a crop that boxes do not follow shows.
  LabelledPicture given;
  given.image = torch::zeros({90, 160, 3});
  given.image.slice(0, 30, 51).slice(1, 40, 71).fill_(1);
  given.boxes = {{40, 30, 70, 50}};
  given.ignored = {{10, 60, 30, 80}};
  given.vehicle_mask.resize(std::size_t{90} * 160);
  for (int y = 30; y <= 50; ++y) std::fill_n(given.vehicle_mask.begin() + y * 160 + 40, 31, std::uint8_t{1});
  int mirrored = 0, larger = 0, smaller = 0, whole = 0;
  for (std::uint64_t index = 0; index < 60; ++index) {
    const LabelledPicture moved = augmented_picture(given, 5, index);
    const std::int64_t rows = moved.image.size(0), columns = moved.image.size(1);
    ASSERT_EQ(moved.vehicle_mask.size(), as_size(rows * columns));
    larger += rows == 90;
    smaller += rows < 90;
    if (moved.boxes.size() != 1) continue;  // cropped away
    ++whole;
    const MiragePictureBox& box = moved.boxes[0];
    mirrored += box.left > 80;
    const auto pixels = bright(moved.image.select(2, 0));
    Tensor mask = torch::empty({rows, columns});
    std::copy(moved.vehicle_mask.begin(), moved.vehicle_mask.end(), mask.data_ptr<float>());
    const auto labelled = bright(mask);
    const float edges[] = {box.left, box.top, box.right, box.bottom};
    for (std::size_t k = 0; k < 4; ++k) {
      EXPECT_NEAR(edges[k], static_cast<float>(pixels[k]), 1.01f) << "edge " << k << " of " << index;
      EXPECT_NEAR(edges[k], static_cast<float>(labelled[k]), 1.2f) << "edge " << k << " of " << index;
    }
  }
  EXPECT_GT(whole, 30);
  EXPECT_GT(mirrored, 5);
  EXPECT_GT(larger, 10);
  EXPECT_GT(smaller, 10);
}

TEST(MovedPicture, WhatTheBorderCutsIsNotTaught) {
  LabelledPicture given;
  given.image = torch::zeros({90, 160, 3});
  given.boxes = {{0, 0, 20, 89}, {139, 0, 159, 89}, {60, 40, 90, 49}};  // the last is 9 pixels high
  int ignored = 0, gone = 0;
  for (std::uint64_t index = 0; index < 200; ++index) {
    const LabelledPicture moved = augmented_picture(given, 6, index);
    const auto width = static_cast<float>(moved.image.size(1)),
               height = static_cast<float>(moved.image.size(0));
    for (const auto* list : {&moved.boxes, &moved.ignored})
      for (const MiragePictureBox& box : *list) {
        EXPECT_GE(box.left, 0);
        EXPECT_GE(box.top, 0);
        EXPECT_LE(box.right, width - 1);
        EXPECT_LE(box.bottom, height - 1);
      }
    for (const MiragePictureBox& box : moved.boxes) EXPECT_GE(box.bottom - box.top, 12);
    ignored += static_cast<int>(moved.ignored.size());
    gone += static_cast<int>(given.boxes.size() - moved.boxes.size() - moved.ignored.size());
  }
  EXPECT_GT(ignored, 20);
  EXPECT_GT(gone, 20);
}

TEST(MovedPicture, DependsOnSeedAndIndexAlone) {
  LabelledPicture given;
  given.image = torch::rand({40, 60, 3});
  const auto a = augmented_picture(given, 7, 3), b = augmented_picture(given, 7, 3),
             c = augmented_picture(given, 7, 4);
  EXPECT_TRUE(torch::equal(a.image, b.image));
  EXPECT_FALSE(a.image.sizes() == c.image.sizes() && torch::equal(a.image, c.image));
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
    if (item.value().dim() == 4) {  // biases may be initialised alike
      EXPECT_EQ(torch::equal(ours[item.key()], item.value()), !item.key().starts_with("mask_")) << item.key();
    }
  std::filesystem::remove(file);
}

/// A picture of 64 × 96 pixels with one labelled box, and no mask. It lives as long as the picture.
MirageSample one_box(const Tensor& picture) {
  static const MiragePictureBox box{20, 20, 60, 50};
  MirageSample sample{};
  sample.input.image = picture.data_ptr<float>();
  sample.input.width = 96, sample.input.height = 64;
  sample.picture_boxes = &box;
  sample.picture_box_count = 1;
  return sample;
}

TEST(CameraNet, TheHeadsLearnWhereNothingTeachesTheMask) {
  const std::string weights =
      std::string(MIRAGE_SOURCE) + "/plugins/detectors/fusion/weights/camera-kitti64.weights";
  Options options;
  options.parts = parts_named("camera");
  options.start = true;
  torch::manual_seed(25);
  const Tensor picture = torch::rand({64, 96, 3});
  const MirageSample sample = one_box(picture);
  EXPECT_THROW(FusionDetector(options, weights.c_str()).train_step({&sample, 1}, 1e-3f), std::runtime_error);

  options.heads = true;
  FusionDetector detector(options, weights.c_str());
  detector.train_step({&sample, 1}, 1e-3f);
  const auto file =
      std::filesystem::temp_directory_path() / ("mirage_heads_" + std::to_string(getpid()) + ".weights");
  detector.save(file.string(), false);
  Network before(options.parts), after(options.parts);
  copy_network(weights, *before);
  copy_network(file.string(), *after);
  std::filesystem::remove(file);
  auto changed = after->named_parameters();
  for (const auto& item : before->named_parameters())
    EXPECT_EQ(!torch::equal(changed[item.key()], item.value()), item.key().starts_with("camera.head"))
        << item.key();
}

TEST(CameraNet, AShareOfTheStartIsKeptThroughAStop) {
  const std::string weights =
      std::string(MIRAGE_SOURCE) + "/plugins/detectors/fusion/weights/camera-kitti64.weights";
  const auto file = [](const char* name) {
    return (std::filesystem::temp_directory_path() /
            ("mirage_keep_" + std::string(name) + std::to_string(getpid()) + ".weights"))
        .string();
  };
  torch::manual_seed(26);
  const Tensor picture = torch::rand({64, 96, 3});
  const MirageSample sample = one_box(picture);
  Options options;
  options.parts = parts_named("camera");
  options.start = true;
  options.heads = true;
  const auto learned = [&](double keep, const char* name) {
    Options of = options;
    of.keep_start = keep;
    FusionDetector first(of, weights.c_str());
    first.train_step({&sample, 1}, 1e-3f);
    first.save(file("checkpoint"), true);
    of.start = false;  // resumes: the checkpoint stores the start weights
    FusionDetector second(of, file("checkpoint").c_str());
    second.train_step({&sample, 1}, 1e-3f);
    second.save(file(name), false);
    second.train_step({&sample, 1}, 1e-3f);  // saving a result does not change the training
    second.save(file((std::string(name) + "later").c_str()), false);
  };
  learned(0, "all");
  learned(0.25, "mixed");
  for (const std::string later : {"", "later"}) {
    Network start(options.parts), all(options.parts), mixed(options.parts);
    copy_network(weights, *start);
    copy_network(file(("all" + later).c_str()), *all);
    copy_network(file(("mixed" + later).c_str()), *mixed);
    auto from = start->named_parameters(), to = all->named_parameters();
    double moved = 0;
    for (const auto& item : mixed->named_parameters()) {
      const Tensor wanted = 0.25 * from[item.key()] + 0.75 * to[item.key()];
      moved += (to[item.key()] - from[item.key()]).abs().sum().item<double>();
      EXPECT_LT((item.value() - wanted).abs().max().item<double>(), 1e-6) << item.key();
    }
    EXPECT_GT(moved, 1e-3);
  }
  for (const char* name : {"checkpoint", "all", "mixed", "alllater", "mixedlater"})
    std::filesystem::remove(file(name));
}

}  // namespace
}  // namespace mirage::fusion
