#include <fmt/format.h>

#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "base/error.h"
#include "base/file_head.h"
#include "base/files.h"
#include "base/json_depth.h"
#include "base/names.h"
#include "base/open_file.h"
#include "scene/shape/shape_model.h"

namespace mirage {
namespace {

constexpr std::string_view kMagic = "MIRAGE-SHAPE 1\n";
constexpr double kFull = 32767;
constexpr double kMaxNodes = 1e7;
constexpr double kMost = 1000;  ///< m and shares: of whatever the header lists

static_assert(std::endian::native == std::endian::little);

nlohmann::json numbers(const auto& v) {
  nlohmann::json out = nlohmann::json::array();
  for (Eigen::Index i = 0; i < v.size(); ++i) out.push_back(v.data()[i]);
  return out;
}

class Header {
 public:
  Header(std::string file, const nlohmann::json& json) : file_(std::move(file)), json_(json) {}

  [[noreturn]] void fail(const std::string& field, const std::string& problem) const {
    throw InputError(file_, field, problem, "make the file again with: mirage fit --build-model FILE");
  }
  std::vector<double> list(const std::string& key, std::size_t count) const {
    if (!json_.contains(key) || !json_.at(key).is_array() || json_.at(key).size() != count)
      fail(key, "missing or not a list of " + std::to_string(count) + " numbers");
    std::vector<double> out;
    for (const auto& value : json_.at(key)) {
      // Asked this way round: what is no number is not within bounds.
      if (!value.is_number() || !(std::abs(value.get<double>()) <= kMost))
        fail(key, "holds a number out of range");
      out.push_back(value.get<double>());
    }
    return out;
  }
  double number(const std::string& key, double low, double high) const {
    if (!json_.contains(key) || !json_.at(key).is_number()) fail(key, "missing or not a number");
    const double value = json_.at(key).get<double>();
    if (!(value >= low && value <= high)) fail(key, "out of range");
    return value;
  }
  Vec3d positive(const std::string& key) const {
    const auto v = list(key, 3);
    for (double x : v)
      if (x < 1e-3) fail(key, "not positive");
    return {v[0], v[1], v[2]};
  }

 private:
  std::string file_;
  const nlohmann::json& json_;
};

}  // namespace

void write_shape_model(const std::filesystem::path& file, const ShapeModel& model) {
  const std::size_t stride = 1 + static_cast<std::size_t>(model.dimension), nodes = model.layout.size();
  std::vector<double> scales(stride, 1e-12);
  for (std::size_t i = 0; i < model.values.size(); ++i)
    scales[i % stride] = std::max<double>(scales[i % stride], std::abs(model.values[i]));
  const nlohmann::json header = {{"reference", numbers(model.reference)},
                                 {"origin", numbers(model.layout.origin)},
                                 {"spacing", numbers(model.layout.spacing)},
                                 {"count", model.layout.count},
                                 {"cut", model.cut},
                                 {"dimension", model.dimension},
                                 {"vehicles", model.vehicles},
                                 {"explained", model.explained},
                                 {"scales", scales},
                                 {"prior_mean", numbers(model.prior_mean)},
                                 {"prior_covariance", numbers(model.prior_covariance)},
                                 {"sources", model.sources}};
  std::string bytes(kMagic);
  bytes += json_text(header) + "\n";
  std::vector<std::int16_t> packed(nodes * stride);
  for (std::size_t i = 0; i < packed.size(); ++i)
    packed[i] = static_cast<std::int16_t>(std::lround(model.values[i] * kFull / scales[i % stride]));
  bytes.append(reinterpret_cast<const char*>(packed.data()), packed.size() * sizeof(packed[0]));
  write_file(file, bytes);
}

ShapeModel read_shape_model(const std::filesystem::path& file) {
  const std::string name = file.string();
  const auto refuse = [&] {
    throw InputError(name, "first line", "not a shape model of this version",
                     "make one with: mirage fit --build-model FILE");
  };
  if (!begins_with(file, kMagic)) refuse();
  constexpr std::size_t kLongestHeader = 1 << 21, kMostValues = 100'000;  // of dimension 200: 41 000 numbers
  const std::string head = read_head(file, kLongestHeader);
  const std::size_t end = head.find('\n', kMagic.size());
  if (end == std::string::npos) refuse();
  const std::string_view second = std::string_view(head).substr(0, end).substr(kMagic.size());
  check_json_depth(second, name);
  check_json_values(second, name, kMostValues);
  const nlohmann::json json = nlohmann::json::parse(second, nullptr, false);
  const Header header(name, json);
  if (!json.is_object()) header.fail("second line", "not a JSON object");
  ShapeModel model;
  model.reference = header.positive("reference");
  const auto origin = header.list("origin", 3), count = header.list("count", 3);
  model.layout.origin = {origin[0], origin[1], origin[2]};
  model.layout.spacing = header.positive("spacing");
  double nodes = 1;
  for (int a = 0; a < 3; ++a) {
    if (count[a] < 2 || count[a] > 1000 || count[a] != std::floor(count[a]))
      header.fail("count", "out of range");
    model.layout.count[a] = static_cast<int>(count[a]);
    nodes *= count[a];
  }
  if (nodes > kMaxNodes) header.fail("count", "out of range");
  model.cut = header.number("cut", 1e-3, 10);
  model.dimension = static_cast<int>(header.number("dimension", 1, 200));
  model.vehicles = static_cast<int>(header.number("vehicles", 1, 1e7));
  const auto k = static_cast<std::size_t>(model.dimension);
  model.explained = header.list("explained", k);
  const auto scales = header.list("scales", k + 1);
  const auto mean = header.list("prior_mean", 3 + k),
             covariance = header.list("prior_covariance", (3 + k) * (3 + k));
  const auto size = static_cast<Eigen::Index>(3 + k);
  model.prior_mean = Eigen::Map<const Eigen::VectorXd>(mean.data(), size);
  model.prior_covariance = Eigen::Map<const Eigen::MatrixXd>(covariance.data(), size, size);
  if (model.prior_covariance.llt().info() != Eigen::Success)
    header.fail("prior_covariance", "not positive definite");
  if (json.contains("sources") && json.at("sources").is_object())
    for (const auto& [source, number] : json.at("sources").items())
      if (number.is_number_integer()) model.sources[source] = number.get<int>();
  const std::size_t numbers_needed = model.layout.size() * (k + 1);
  const auto check = [&](std::uintmax_t bytes) {
    const std::uintmax_t held = bytes > end ? bytes - end - 1 : 0,
                         needed = numbers_needed * sizeof(std::int16_t);
    if (held != needed)
      header.fail("numbers", fmt::format("the file holds {} bytes of them, {} are needed", held, needed));
  };
  check(OpenFile(file).size());  // before any of them is in memory
  const std::string all = read_file(file);
  check(all.size());
  model.values.resize(numbers_needed);
  for (std::size_t i = 0; i < numbers_needed; ++i) {
    std::int16_t packed = 0;
    std::memcpy(&packed, all.data() + end + 1 + i * sizeof packed, sizeof packed);
    model.values[i] = static_cast<float>(packed * scales[i % (k + 1)] / kFull);
  }
  return model;
}

}  // namespace mirage
