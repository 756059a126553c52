#include "simulation/sensor_plugin.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "base/fields.h"
#include "base/files.h"
#include "base/plugins.h"
#include "base/sizes.h"
#include "simulation/sensor_abi.h"

namespace mirage {

namespace fs = std::filesystem;

namespace {

constexpr const char* kSensorPlugins = "sensor";
constexpr std::int64_t kMaxValues = std::int64_t{1} << 28;

fs::path sensor_file(const std::string& word) {
  if (is_plugin_path(word)) {
    if (!fs::exists(word)) throw InputError(word, "", "no such sensor plugin", "check --sensors");
    return fs::absolute(word);
  }
  if (const ShippedPlugin* plugin = shipped_plugin(kSensorPlugins, word)) return plugin->file;
  std::vector<std::string> known;
  for (const ShippedPlugin& shipped : shipped_plugins(kSensorPlugins))
    known.insert(known.end(), shipped.words.begin(), shipped.words.end());
  throw unknown_word("sensors", word, known, "a plugin (*.so)");
}

/// Double as the plugin reads it, row-major.
std::vector<double> flat(const std::vector<Vec3d>& points) {
  std::vector<double> values;
  values.reserve(3 * points.size());
  for (const Vec3d& p : points) values.insert(values.end(), {p.x(), p.y(), p.z()});
  return values;
}

void accumulate(const std::vector<double>& values, std::vector<Vec3d>& to) {
  for (std::size_t i = 0; i < to.size(); ++i) to[i] += Vec3d::Map(values.data() + 3 * i);
}

MirageBody body_of(const Label& label) {
  constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
  const BevBox& box = label.box.bev;
  const Vec3d velocity = label.velocity.value_or(Vec3d::Constant(kUnknown));
  return {box.x,
          box.y,
          label.box.bottom + label.box.height / 2,
          box.length,
          box.width,
          label.box.height,
          box.yaw,
          {velocity.x(), velocity.y(), velocity.z()}};
}

/// A frame as the plugin gets it: a copy, independent of later crops of the frame.
struct RawScene {
  RawScene(const Frame& frame, const fs::path& data)
      : folder(data.string()), id(frame.id), sweep(frame.sweep) {
    static_assert(sizeof(LidarPoint) == 4 * sizeof(float));
    for (const Label& label : frame.labels)
      if (has_box(label)) bodies.push_back(body_of(label));
    scene = {folder.c_str(),
             id.c_str(),
             reinterpret_cast<const float*>(sweep.data()),
             static_cast<std::int64_t>(sweep.size()),
             bodies.data(),
             static_cast<std::int64_t>(bodies.size())};
  }
  RawScene(const RawScene&) = delete;
  RawScene& operator=(const RawScene&) = delete;
  std::string folder, id;
  Sweep sweep;
  std::vector<MirageBody> bodies;
  MirageSensorScene scene{};
};

}  // namespace

/// A plugin with one instance. A tape keeps the objects alive that it refers to.
class PluginSensor {
 public:
  PluginSensor(fs::path of, const MirageSensorApi* table) : file(std::move(of)), api(table) {
    if (!api->create || !api->destroy || !api->word || !api->measure || !api->vjp || !api->release)
      throw InputError(file.string(), "mirage_sensor_api", "a function is missing", "rebuild the plugin");
    char error[kPluginErrorSize] = "";
    sensor = call_plugin(file, "create", [&] { return api->create("{}", error, kPluginErrorSize); });
    if (!sensor)
      throw InputError(file.string(), "", error[0] ? error : "the plugin gave no reason",
                       "rebuild the plugin");
    const MirageSensorWord* word_of_plugin = call_plugin(file, "word", [&] { return api->word(sensor); });
    const auto bad = [&](const char* field, const char* problem) {
      api->destroy(sensor);
      return InputError(file.string(), field, problem, "rebuild the plugin");
    };
    if (!word_of_plugin || !word_of_plugin->name || !*word_of_plugin->name)
      throw bad("word", "tells no name");
    word.name = word_of_plugin->name;
    std::copy(std::begin(word_of_plugin->shape), std::end(word_of_plugin->shape), word.shape.begin());
    std::int64_t count = 1;
    for (const std::int64_t length : word.shape) {
      if (length < 1 || length > kMaxValues / count) throw bad("shape", "has no length, or too many values");
      count *= length;
    }
    values = as_size(count);
    word.sensor_from_ego.matrix().topRows<3>() =
        Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(word_of_plugin->sensor_from_ego);
    if (!word.sensor_from_ego.matrix().allFinite()) throw bad("sensor_from_ego", "is not finite");
  }
  PluginSensor(const PluginSensor&) = delete;
  PluginSensor& operator=(const PluginSensor&) = delete;
  ~PluginSensor() { api->destroy(sensor); }

  std::vector<double> measure(const MirageSensorScene& scene, const MirageSensorObject* object,
                              const double* recorded, void** tape) const {
    std::vector<double> data(values);
    run_plugin(file, "measure", [&](char* error) {
      return api->measure(sensor, &scene, object, recorded, data.data(), tape, error, kPluginErrorSize);
    });
    if (!std::all_of(data.begin(), data.end(), [](double value) { return std::isfinite(value); }))
      throw Failure(file.string(), "measure gave a number that is not finite",
                    "look for divisions, roots and logarithms of 0");
    return data;
  }

  fs::path file;
  const MirageSensorApi* api;
  void* sensor = nullptr;
  Measurement word;  ///< without data
  std::size_t values = 0;
};

namespace {

/// One recorded scene, measured with an object in it.
class SceneSensor : public SensorPass {
 public:
  /// `place`: index of its measurement among the frame's.
  SceneSensor(std::shared_ptr<const PluginSensor> of, std::shared_ptr<const RawScene> raw, std::size_t place)
      : of_(std::move(of)), raw_(std::move(raw)), place_(place) {}

  SensorVjp draw(const PreparedFrame& prepared, const Placement& placement, const TexturedMesh& placed,
                 const SimulationSettings&, Simulated& result) const override {
    const auto& own = prepared.frame.measurements.at(place_).data;
    const std::vector<double> vertices = flat(placed.mesh.vertices), albedo = flat(placed.atlas.texels);
    std::vector<std::int32_t> faces;
    faces.reserve(3 * placed.mesh.faces.size());
    for (const Face& face : placed.mesh.faces)
      for (const auto vertex : face) faces.push_back(static_cast<std::int32_t>(vertex));
    const Vec3d velocity =
        placement.carrier ? placement.carrier->label.velocity.value_or(Vec3d::Zero()) : Vec3d::Zero();
    const MirageSensorObject object{vertices.data(),
                                    static_cast<std::int64_t>(placed.mesh.vertices.size()),
                                    faces.data(),
                                    static_cast<std::int64_t>(placed.mesh.faces.size()),
                                    albedo.data(),
                                    static_cast<std::int64_t>(placed.atlas.per_face()),
                                    {velocity.x(), velocity.y(), velocity.z()}};
    const std::vector<double> recorded(own.begin(), own.end());
    const std::shared_ptr<void*> tape(new void*(nullptr), [of = of_](void** left) {
      if (*left) of->api->release(*left);
      delete left;
    });
    const std::vector<double> values = of_->measure(raw_->scene, &object, recorded.data(), tape.get());
    Measurement& measured = result.measurements.at(place_) = of_->word;
    measured.data.assign(values.begin(), values.end());
    return [of = of_, tape, place = place_](const Simulated& simulated, const TexturedMesh&,
                                            const Upstream& upstream, AdversaryGradient& gradient) {
      if (upstream.others.empty()) return;
      const GradientView& d_data = upstream.others[simulated.others.size() + place];
      if (!d_data) return;
      std::vector<double> d_values(of->values), d_vertices(3 * gradient.vertices.size()),
          d_albedo(3 * gradient.texels.size());
      for (std::size_t i = 0; i < d_values.size(); ++i) d_values[i] = d_data[i];
      run_plugin(of->file, "vjp", [&](char* error) {
        return of->api->vjp(of->sensor, *tape, d_values.data(), d_vertices.data(), d_albedo.data(), error,
                            kPluginErrorSize);
      });
      accumulate(d_vertices, gradient.vertices);
      accumulate(d_albedo, gradient.texels);
    };
  }

 private:
  std::shared_ptr<const PluginSensor> of_;
  std::shared_ptr<const RawScene> raw_;
  std::size_t place_;
};

}  // namespace

std::vector<std::shared_ptr<const PluginSensor>> load_sensors(const std::string& words) {
  std::vector<std::shared_ptr<const PluginSensor>> sensors;
  std::set<std::string> names;
  for (const std::string& word : listed_words(words)) {
    const fs::path file = sensor_file(word);
    const auto* api = open_plugin<MirageSensorApi>(file, "mirage_sensor_api", "simulation/sensor_abi.h",
                                                   {MIRAGE_SENSOR_ABI});
    auto sensor = std::make_shared<const PluginSensor>(file, api);
    if (!names.insert(sensor->word.name).second)
      throw FieldError("sensors", words, fmt::format("has two sensors called {}", sensor->word.name),
                       "name each once");
    sensors.push_back(std::move(sensor));
  }
  return sensors;
}

bool is_shipped_sensor(const std::string& word) {
  return shipped_plugin(kSensorPlugins, word) != nullptr;
}

std::vector<std::shared_ptr<const SensorPass>> record(
    const std::vector<std::shared_ptr<const PluginSensor>>& sensors, const fs::path& data, Frame& frame) {
  std::vector<std::shared_ptr<const SensorPass>> passes;
  passes.reserve(sensors.size());
  for (const auto& sensor : sensors) {
    auto raw = std::make_shared<const RawScene>(frame, data);
    const std::vector<double> values = sensor->measure(raw->scene, nullptr, nullptr, nullptr);
    frame.measurements.push_back(sensor->word);
    frame.measurements.back().data.assign(values.begin(), values.end());
    passes.push_back(
        std::make_shared<const SceneSensor>(sensor, std::move(raw), frame.measurements.size() - 1));
  }
  return passes;
}

std::string sensors_identity(const std::string& words) {
  std::string all;
  for (const std::string& word : listed_words(words)) all += file_hash(sensor_file(word)) + "\n";
  return all;
}

}  // namespace mirage
