// Weights files: parts, refused files, training state, and the converter of LibTorch's archives.
#include <gtest/gtest.h>
#include <torch/serialize.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <functional>

#include "base/files.h"
#include "fusion_detector.h"
#include "weights.h"
#include "weights_file.h"

namespace mirage::fusion {
namespace {

namespace fs = std::filesystem;
using torch::Tensor;

class Weights : public testing::Test {
 protected:
  Weights() { fs::create_directories(folder); }
  ~Weights() override { fs::remove_all(folder); }
  /// Runs the Python converter, which must succeed.
  void convert(const std::string& arguments) const {
    const std::string command =
        "cd '" + folder.string() + "' && /usr/bin/python3 '" + MIRAGE_SOURCE "/plugins/convert_weights.py' ";
    ASSERT_EQ(std::system((command + arguments).c_str()), 0) << arguments;
  }
  const fs::path folder = fs::temp_directory_path() / ("mirage_weights_" + std::to_string(getpid()));
};

std::string refusal_of(const fs::path& file) {
  try {
    parts_of(open_weights(file.string()));
  } catch (const std::exception& problem) {
    return problem.what();
  }
  return "";
}

Network network_of(const char* name, std::uint64_t seed) {
  torch::manual_seed(seed);
  return Network(parts_named(name));
}

/// Expects equal tensors in both; `half`: tensors of two or more dimensions were rounded to half precision.
void expect_same(NetworkImpl& read, NetworkImpl& from, bool half) {
  auto theirs = from.named_parameters();
  theirs.update(from.named_buffers());
  auto ours = read.named_parameters();
  ours.update(read.named_buffers());
  ASSERT_EQ(ours.size(), theirs.size());
  for (const auto& item : ours) {
    const Tensor& value = theirs[item.key()];
    const Tensor expected = half && value.dim() > 1 ? value.to(torch::kHalf).to(torch::kFloat) : value;
    EXPECT_TRUE(torch::equal(item.value(), expected)) << item.key();
  }
}

TEST_F(Weights, HoldEveryTypeToTheBit) {
  torch::manual_seed(1);
  const Tensor kernel = torch::randn({2, 3, 4}).transpose(0, 2), half = torch::randn({5}).to(torch::kHalf);
  WeightsWriter writer;
  writer.state("said", "a \"text\"\n");
  writer.add("kernel", kernel);
  writer.add("half", half);
  writer.add("steps", torch::tensor(std::int64_t{1} << 40, torch::kLong));
  writer.add("rate", torch::tensor(0.1, torch::kDouble));
  writer.write(folder / "a.weights");
  const WeightsFile file(folder / "a.weights");
  EXPECT_EQ(file.fact("said"), "a \"text\"\n");
  EXPECT_EQ(file.fact("unsaid"), "");
  EXPECT_TRUE(torch::equal(file.tensor("kernel", {4, 3, 2}), kernel));
  EXPECT_TRUE(torch::equal(file.tensor("half", {5}), half));
  EXPECT_EQ(file.tensor("steps", {}).item<std::int64_t>(), std::int64_t{1} << 40);
  EXPECT_EQ(file.tensor("rate", {}).item<double>(), 0.1);
  EXPECT_THROW(file.tensor("kernel", {3, 4, 2}), std::runtime_error);
  EXPECT_THROW(file.tensor("none", {}), std::runtime_error);
}

TEST_F(Weights, OfPartsAreThoseOfTheWholeFile) {
  Network late = network_of("late", 2), lidar = network_of("lidar", 3), camera = network_of("camera", 4);
  begin_weights(*lidar).write(folder / "lidar.weights");
  begin_weights(*camera).write(folder / "camera.weights");
  copy_network((folder / "lidar.weights").string(), *late);
  copy_network((folder / "camera.weights").string(), *late);
  begin_weights(*late).write(folder / "whole.weights");
  convert("--part lidar.weights --part camera.weights whole.weights late.weights");
  EXPECT_LT(fs::file_size(folder / "late.weights"), 20'000);
  Network read = network_of("late", 5);
  copy_network((folder / "late.weights").string(), *read);
  expect_same(*read, *late, false);
  convert("late.weights again.weights");  // and back
  EXPECT_EQ(read_file(folder / "again.weights"), read_file(folder / "whole.weights"));

  // A file's hash also covers its parts, because other parts are refused.
  begin_weights(*network_of("lidar", 6)).write(folder / "lidar.weights");
  EXPECT_NE(refusal_of(folder / "late.weights").find("needs lidar.weights of SHA-256"), std::string::npos)
      << refusal_of(folder / "late.weights");
  fs::remove(folder / "lidar.weights");
  EXPECT_NE(refusal_of(folder / "late.weights").find("needs lidar.weights beside it"), std::string::npos);
}

TEST_F(Weights, AreRoundedToHalvesOnlyWhereTheConverterIsAsked) {
  Network lidar = network_of("lidar", 7);
  begin_weights(*lidar).write(folder / "whole.weights");
  convert("--half whole.weights half.weights");
  EXPECT_LT(fs::file_size(folder / "half.weights"),
            0.52 * static_cast<double>(fs::file_size(folder / "whole.weights")));
  Network read = network_of("lidar", 8), exact = network_of("lidar", 9);
  copy_network((folder / "half.weights").string(), *read);
  expect_same(*read, *lidar, true);
  copy_network((folder / "whole.weights").string(), *exact);
  expect_same(*exact, *lidar, false);
}

TEST_F(Weights, AreRefusedInWordsForTheUser) {
  const auto refused = [&](const std::string& bytes, const char* said) {
    write_file(folder / "a.weights", bytes);
    EXPECT_NE(refusal_of(folder / "a.weights").find(said), std::string::npos)
        << refusal_of(folder / "a.weights") << "\nin place of\n"
        << said;
  };
  begin_weights(*network_of("lidar", 10)).write(folder / "whole.weights");
  std::string bytes = read_file(folder / "whole.weights");
  refused(bytes.substr(0, bytes.size() / 2),
          "not a readable weights file (a tensor lies outside of the file)");
  refused("PK\3\4 and so on", "python3 convert_weights.py OLD NEW");
  bytes.replace(bytes.size() - 4, 4, std::string("\0\0\x80\x7f", 4));
  refused(bytes, "not finite");
  refused(tensor_file_bytes({{"format", "of somebody else"}}, {}), "weights of another program or version");
  refused(tensor_file_bytes({{"format", "mirage fusion detector 3"}, {"detector", "radar"}}, {}),
          "modality: unknown value 'radar'");
}

TEST_F(Weights, OfNoNetworkAreRefused) {
  const auto refusal = [&](const std::function<void(WeightsWriter&)>& change) -> std::string {
    Network lidar = network_of("lidar", 13);
    WeightsWriter writer = begin_weights(*lidar);
    change(writer);
    writer.write(folder / "a.weights");
    try {
      copy_network((folder / "a.weights").string(), *lidar);
    } catch (const std::exception& problem) {
      return problem.what();
    }
    return "";
  };
  const auto buffers = network_of("lidar", 13)->named_buffers();
  std::string variance;
  for (const auto& item : buffers)
    if (item.key().ends_with("variance")) variance = item.key();
  ASSERT_FALSE(variance.empty());
  EXPECT_EQ(refusal([](WeightsWriter&) {}), "");
  EXPECT_EQ(refusal([](WeightsWriter& w) { w.add("training.steps", torch::tensor(3, torch::kLong)); }), "");
  EXPECT_NE(refusal([](WeightsWriter& w) { w.add("more", torch::zeros({2})); }).find("more is unknown"),
            std::string::npos);
  for (const auto type : {torch::kDouble, torch::kLong})
    EXPECT_NE(refusal([&](WeightsWriter& w) {
                w.add(variance, buffers[variance].to(type));
              }).find(variance + " is neither F32 nor F16"),
              std::string::npos);
  EXPECT_NE(refusal([&](WeightsWriter& w) { w.add(variance, -buffers[variance]); }).find("is negative"),
            std::string::npos);
}

TEST_F(Weights, AHeaderWithAKeyTwiceIsRefused) {
  const std::string data(8, '\0');
  const auto refusal = [&](std::string header) -> std::string {
    const std::uint64_t length = header.size();
    try {
      parse_tensor_file(std::string(reinterpret_cast<const char*>(&length), sizeof length) + header + data);
    } catch (const std::exception& problem) {
      return problem.what();
    }
    return "";
  };
  const std::string one = R"({"dtype":"F32","shape":[2],"data_offsets":[0,8]})";
  EXPECT_EQ(refusal(R"({"a":)" + one + "}"), "");
  EXPECT_NE(refusal(R"({"a":)" + one + R"(,"a":)" + one + "}").find("a key twice"), std::string::npos);
  EXPECT_NE(refusal(R"({"a":{"dtype":"F64","dtype":"F32","shape":[2],"data_offsets":[0,8]}})").find("twice"),
            std::string::npos);
}

TEST_F(Weights, TheConverterRefusesAnotherPartAndADamagedHeader) {
  Network lidar = network_of("lidar", 14);
  begin_weights(*lidar).write(folder / "part.weights");
  begin_weights(*lidar).write(folder / "whole.weights");
  convert("--part part.weights whole.weights small.weights");
  convert("small.weights again.weights");
  std::string bytes = read_file(folder / "part.weights");
  bytes[bytes.size() - 3] ^= 1;
  write_file(folder / "part.weights", bytes);
  write_file(folder / "damaged.weights", std::string(7, '\xff') + "\x7f{");
  for (const auto& [file, said] :
       {std::pair("small", "needs part.weights of SHA-256"), {"damaged", "does not begin with a header"}}) {
    const std::string command = "/usr/bin/python3 '" MIRAGE_SOURCE "/plugins/convert_weights.py' '" +
                                (folder / file).string() + ".weights' '" + (folder / "new.weights").string() +
                                "' 2> '" + (folder / "said").string() + "'";
    EXPECT_NE(std::system(command.c_str()), 0);
    const std::string text = read_file(folder / "said");
    EXPECT_NE(text.find(said), std::string::npos) << text;
    EXPECT_EQ(text.find("Traceback"), std::string::npos) << text;
    EXPECT_FALSE(fs::exists(folder / "new.weights"));
  }
}

// The shipped files are complete and small enough for a repository.
TEST(ShippedWeights, AreReadableAndSmall) {
  std::uintmax_t bytes = 0;
  for (const auto& entry : fs::directory_iterator(MIRAGE_SOURCE "/plugins/detectors/fusion/weights")) {
    if (entry.path().extension() != ".weights") continue;
    bytes += entry.file_size();
    Network network(parts_of(open_weights(entry.path().string())));
    EXPECT_NO_THROW(copy_network(entry.path().string(), *network)) << entry.path();
  }
  EXPECT_GT(bytes, 0u);
  EXPECT_LT(bytes, 36'000'000u);
}

/// The archive that Mirage wrote before it had its own format.
void write_archive(const fs::path& file, NetworkImpl& network, torch::optim::AdamW& optimiser) {
  torch::serialize::OutputArchive archive, stored, state;
  archive.write("format", c10::IValue("mirage fusion detector 2"));
  for (const auto& [flag, value] : {std::pair("with_image", false),
                                    {"denoising", false},
                                    {"depth_gate", false},
                                    {"camera", true},
                                    {"without_lidar", false},
                                    {"painted", false},
                                    {"late", true},
                                    {"second", false},
                                    {"channel_norm", true},
                                    {"camera_frozen", true},
                                    {"lidar_frozen", false},
                                    {"trunk_frozen", false},
                                    {"with_optimiser", true}})
    archive.write(flag, c10::IValue(value));
  network.save(stored);
  archive.write("network", stored);
  archive.write("steps", c10::IValue(std::int64_t{12}));
  archive.write("samples_seen", c10::IValue(std::int64_t{24}));
  archive.write("peak_rate", c10::IValue(0.1));
  optimiser.save(state);
  archive.write("optimiser", state);
  archive.write("start0", torch::full({3}, 7.f));
  archive.save_to(file.string());
}

TEST_F(Weights, OfAnEarlierMirageAreConvertedToTheBit) {
  Network old = network_of("late", 11);
  std::vector<Tensor> parameters = old->parameters();
  torch::optim::AdamW optimiser(parameters, torch::optim::AdamWOptions(1e-3));
  for (std::size_t k = 0; k < parameters.size(); ++k)
    if (k != 1) parameters[k].mutable_grad() = torch::randn_like(parameters[k]);  // one had no gradient yet
  optimiser.step();
  optimiser.step();
  write_archive(folder / "old.weights", *old, optimiser);
  EXPECT_NE(refusal_of(folder / "old.weights").find("convert_weights.py"), std::string::npos);
  convert("old.weights new.weights");

  Network read = network_of("late", 12);
  copy_network((folder / "new.weights").string(), *read);
  expect_same(*read, *old, false);
  const WeightsFile file = open_weights((folder / "new.weights").string());
  EXPECT_TRUE(has_word(file, "frozen", "camera"));
  EXPECT_FALSE(has_word(file, "frozen", "lidar"));
  EXPECT_EQ(file.tensor("training.steps", {}).item<std::int64_t>(), 12);
  EXPECT_EQ(file.tensor("training.samples_seen", {}).item<std::int64_t>(), 24);
  EXPECT_EQ(file.tensor("training.peak_rate", {}).item<double>(), 0.1);
  EXPECT_TRUE(torch::equal(file.tensor("start0", {3}), torch::full({3}, 7.f)));

  // Both optimisers take the same next step.
  torch::optim::AdamW again(read->parameters(), torch::optim::AdamWOptions(1e-3));
  read_state(file, again);
  const std::vector<Tensor> ours = read->parameters();
  for (std::size_t k = 0; k < ours.size(); ++k)
    if (parameters[k].grad().defined()) ours[k].mutable_grad() = parameters[k].grad();
  optimiser.step();
  again.step();
  for (std::size_t k = 0; k < ours.size(); ++k) EXPECT_TRUE(torch::equal(ours[k], parameters[k])) << k;
}

TEST_F(Weights, OfAnotherLibTorchArchiveAreNotConverted) {
  torch::serialize::OutputArchive archive;
  archive.write("format", c10::IValue("somebody else's"));
  archive.save_to((folder / "other.pt").string());
  const std::string command = "/usr/bin/python3 '" MIRAGE_SOURCE "/plugins/convert_weights.py' '" +
                              (folder / "other.pt").string() + "' '" + (folder / "new.weights").string() +
                              "' 2> '" + (folder / "said").string() + "'";
  EXPECT_NE(std::system(command.c_str()), 0);
  EXPECT_NE(read_file(folder / "said").find("not of Mirage's weights"), std::string::npos);
  EXPECT_FALSE(fs::exists(folder / "new.weights"));
}

}  // namespace
}  // namespace mirage::fusion
