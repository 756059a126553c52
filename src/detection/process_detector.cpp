#include "detection/process_detector.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spdlog/spdlog.h>
#include <wordexp.h>

#include <algorithm>
#include <bit>
#include <mutex>
#include <numeric>
#include <optional>
#include <set>

#include "base/child_process.h"
#include "base/error.h"
#include "base/files.h"
#include "base/image.h"
#include "base/memory.h"
#include "base/names.h"
#include "base/parallel.h"
#include "base/random.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "detection/car_in_picture.h"
#include "scene/data/data_set.h"

namespace mirage {
namespace {

Detection detection_of(const float* row, std::size_t columns, bool in_picture) {
  Detection found;
  if (in_picture)
    found.picture = {row[0], row[1], row[2], row[3]};
  else if (columns == 5)
    found.box.bev = {row[0], row[1], row[2], row[3], row[4]};
  else
    found.box = {{row[0], row[1], row[3], row[4], row[6]}, row[2] - row[5] / 2.0, row[5]};
  if (columns == 9) found.velocity = Vec3d(row[7], row[8], 0);
  return found;
}

using nlohmann::json;

constexpr std::string_view kProgramPrefix = "exec:";
constexpr int kProtocol = 1;
constexpr int kTries = 3;                         // at one frame
constexpr double kPatience = 10;                  // s after Ctrl-C for the frame at hand
constexpr std::size_t kAlign = 64;                // bytes, of arrays
constexpr std::size_t kMinAnswerBytes = 1 << 26;  // bytes for answers; only written pages take memory
constexpr const char* kAnswerAsAsked =
    R"(answer with the job's "id" as it was given, and with "ok" true or false, without quotes)";

/// The words of the command, split as by a shell, without command substitution.
std::vector<std::string> command_words(const std::string& detector) {
  const std::string command = detector.substr(kProgramPrefix.size());
  wordexp_t parts{};
  const int status = ::wordexp(command.c_str(), &parts, WRDE_NOCMD);
  std::vector<std::string> words;
  if (status == 0) words.assign(parts.we_wordv, parts.we_wordv + parts.we_wordc);
  if (status == 0 || status == WRDE_NOSPACE) ::wordfree(&parts);
  if (words.empty())
    throw FieldError("detector", detector, "is not a command",
                     "write \"exec:PROGRAM ARGUMENTS\", with what a shell would act on in quotes");
  return words;
}

/// The file or folder that a word of a command names, alone or behind a "=" ("--weights=FILE").
struct NamedByWord {
  std::size_t at = 0;                                                  ///< where in the word the name begins
  std::filesystem::file_type type = std::filesystem::file_type::none;  ///< none: neither file nor folder
};
NamedByWord named_by(const std::string& word) {
  using std::filesystem::file_type;
  for (std::size_t at = 0; at < word.size();) {
    std::error_code none;
    const file_type type = std::filesystem::status(word.substr(at), none).type();
    if (type == file_type::regular || type == file_type::directory) return {at, type};
    const std::size_t sign = word.find('=', at);
    if (sign == std::string::npos) break;
    at = sign + 1;
  }
  return {};
}

/// Warns once for each command of the words whose contents program_hash() does not include.
void warn_of_uncounted(const std::string& detector, const std::vector<std::string>& words) {
  static std::mutex mutex;
  static std::set<std::string> said;
  const std::lock_guard lock(mutex);
  if (words.empty() || rank() > 0 || !said.insert(detector).second) return;
  spdlog::warn(
      "{}: what {} holds does not count as the detector's content, and a run goes on when it changes; name "
      "its files in the command",
      detector, fmt::join(words, ", "));
}

/// An array in the shared memory, as a message names it.
json array_at(std::size_t at, std::vector<std::size_t> shape, const char* type) {
  return {{"at", at}, {"shape", std::move(shape)}, {"type", type}};
}

std::size_t aligned(std::size_t at) {
  return (at + kAlign - 1) / kAlign * kAlign;
}

json rows_json(const Transform& transform) {
  json rows = json::array();
  for (const double value : transform.matrix().topRows<3>().reshaped<Eigen::RowMajor>())
    rows.push_back(value);
  return rows;
}

class ProcessDetector : public ExternalDetector {
 public:
  ProcessDetector(const DetectorOptions& options, const ProcessLimits& limits)
      : ExternalDetector(options.detector, options.detector),
        limits_(limits),
        words_(command_words(error_name_)) {
    const std::filesystem::path program = find_program(words_[0]);
    if (program.empty())
      throw FieldError("detector", error_name_, "names a program that is not on PATH: " + words_[0],
                       "write \"exec:PROGRAM ARGUMENTS\"");
    words_[0] = program;
    // Added to the user's own: mirage_serve.py needs no installation.
    const char* before = std::getenv("PYTHONPATH");
    const std::string folder = built_file("plugins/process");
    words_.insert(words_.begin(), {"/usr/bin/env", fmt::format("PYTHONPATH={}{}{}", folder, before ? ":" : "",
                                                               before ? before : "")});
    hello_ = {{"job", "hello"},
              {"protocol", kProtocol},
              {"memory", memory_.path()},
              {"threads", options.threads > 0 ? options.threads : thread_count()},
              {"seed", options.seed}};
    memory_.reserve(kMinAnswerBytes);
    read_hello(start());
  }
  ~ProcessDetector() override {
    constexpr double kToEnd = 5;  // s
    if (worker_) worker_->stop(interrupted() ? 0 : kToEnd);
  }
  ProcessDetector(const ProcessDetector&) = delete;
  ProcessDetector& operator=(const ProcessDetector&) = delete;

  std::vector<Detection> forward(const SensorView& view, double score_threshold, bool keep_graph) override {
    if (keep_graph && !description_.can.has_gradients) throw_no_gradient();
    forward_ = place(view, score_threshold, keep_graph);
    json answer;
    try {
      answer = exchange(forward_);
    } catch (const Failure& problem) {
      throw_if_blind(view, problem.what());
      throw;
    }
    const auto boxes = array<float>(answer, "boxes", 2);
    const auto logits = array<float>(answer, "logits", 1);
    if (!all_finite(boxes.values)) not_finite("boxes");
    if (!all_finite(logits.values)) not_finite("logits");
    const std::size_t count = boxes.shape[0], columns = boxes.shape[1];
    bool whole = logits.shape[0] == count;
    const auto numbers = [&](const char* field) {
      Array<std::int32_t> of;
      if (answer.contains(field)) of = array<std::int32_t>(answer, field, 1);
      whole = whole && (of.shape.empty() || of.shape[0] == count);
      return of;
    };
    const Array<std::int32_t> classes = numbers("classes"), identities = numbers("identities");
    if (!BoxRows::knows(columns, !description_.can.finds_bev) || !whole)
      throw Failure(
          error_name_,
          fmt::format("gave boxes of shape {} × {} with {} logits", count, columns, logits.shape[0]),
          BoxRows::guide());
    const int width = view.image ? view.image->width : 0, height = view.image ? view.image->height : 0;
    return rows_.proposals(
        {boxes.values.data(), logits.values.data(), count, columns, classes.values, identities.values},
        description_.can, score_threshold, width, height, error_name_);
  }

  SensorGradient backward(std::span<const double> d_logits) override {
    if (!description_.can.has_gradients) throw_no_gradient();
    const std::vector<float> all = rows_.of_rows(d_logits);
    copy_bytes(memory_.data() + d_logits_at_, all.data(), all.size() * sizeof(float));
    const json answer = exchange({{"job", "gradient"},
                                  {"d_logits", array_at(d_logits_at_, {all.size()}, "float32")},
                                  {"answer_at", answer_at_},
                                  {"size", memory_.size()}});
    return gradient([&](const ExternalSensor& sensor) { return take(answer, sensor); });
  }

  TrainingLoss train_step(std::span<const TrainingSample>, double) override {
    throw FieldError("detector", error_name_, "is trained in its own program", "train it there");
  }
  void save(const std::filesystem::path& file, bool) override {
    throw InputError(file.string(), "detector", "a program's network has no weights file here",
                     "save it there");
  }

 private:
  /// An array as the program wrote it.
  template <class T>
  struct Array {
    std::span<const T> values;
    std::vector<std::size_t> shape;
  };

  [[noreturn]] void throw_no_gradient() const {
    throw FieldError("detector", error_name_, "gives no gradient, and an attack follows it",
                     "let the program tell \"gradient\": true and answer the job gradient");
  }

  /// Starts the program and returns its answer to hello. InputError if there is no answer.
  json start() {
    worker_.emplace(words_, "", "the detector was at work", kPatience);
    json answer;
    if (worker_->exchange(hello_, limits_.start, answer, true)) return answer;
    const bool broke_protocol = worker_->broke_protocol();
    const std::string how = broke_protocol   ? worker_->lost()
                            : worker_->end() ? fmt::format("ended before it served ({})", *worker_->end())
                                             : "does not serve: it " + worker_->lost();
    worker_.reset();
    throw FieldError("detector", error_name_, how,
                     broke_protocol
                         ? kAnswerAsAsked
                         : "run the command by itself: it must end with serve(…) (mirage_serve.py)");
  }

  void read_hello(const json& answer) {
    if (!answer["ok"].get<bool>())
      throw FieldError("detector", error_name_, "hello " + text_of(answer, "error", "failed"),
                       "look at what it printed");
    if (answer.value("protocol", json()) != kProtocol)
      throw FieldError("detector", error_name_,
                       "protocol is " + answer.value("protocol", json()).dump() + ", not 1",
                       "use the mirage_serve.py or mirage_process.h of this version");
    description_ = read_external_description(answer, error_name_);
  }

  /// Writes the sensor's array into the memory at `at`, moves `at` behind it, returns its location.
  json write(const SensorData& sensor, ExternalSensor& its, std::size_t& at) {
    const bool bytes = its.kind == SensorData::Kind::camera && description_.bytes;
    its.at = at;
    at += aligned(its.values() * (bytes ? 1 : sizeof(float)));
    memory_.reserve(at);
    char* to = memory_.data() + its.at;
    if (bytes)
      write_srgb_bytes(sensor.image->data, reinterpret_cast<std::uint8_t*>(to));
    else
      copy_bytes(to, first_value(sensor), its.values() * sizeof(float));
    return array_at(its.at, its.shape, bytes ? "uint8" : "float32");
  }

  /// Writes the view's sensors into the memory; returns the job that names them.
  json place(const SensorView& view, double score_threshold, bool keep_graph) {
    std::size_t at = 0, gradients = 0;
    json job = describe_input(
        view, [&](const SensorData& sensor, ExternalSensor& its) { return write(sensor, its, at); });
    for (const ExternalSensor& sensor : sensors_) gradients += aligned(sensor.values() * sizeof(float));
    d_logits_at_ = at;
    const std::size_t room = std::max(kMinAnswerBytes, 2 * gradients);
    answer_at_ = aligned(d_logits_at_ + room / 4);
    memory_.reserve(answer_at_ + room);
    job.update({{"job", "detect"},
                {"threshold", score_threshold},
                {"gradient", keep_graph},
                {"answer_at", answer_at_},
                {"size", memory_.size()}});
    return job;
  }

  /// The answer to a job on the current frame. A lost process is started again; for a gradient it gets the
  /// frame again. Failure if it remembers and the frame continues a sequence.
  json exchange(const json& job) {
    const bool again = job["job"] == "gradient",
               remembered = description_.can.remembers && forward_.value("continues", false);
    const auto throw_if_remembered = [&](const std::string& how) {
      if (remembered)
        throw Failure(error_name_, how + " in the middle of a sequence: what it remembered is lost",
                      "look at what the program printed, and run the command again");
    };
    for (int attempt = 1;; ++attempt) {
      json answer;
      const bool fresh = !worker_;
      if (fresh) throw_if_remembered("was started anew"), start();
      const bool ready = !(fresh && again) || worker_->exchange(forward_, limits_.answer, answer);
      if (ready && worker_->exchange(job, limits_.answer, answer)) {
        if (answer["ok"].get<bool>()) return answer;
        throw Failure(error_name_,
                      fmt::format("{} failed ({})", job["job"].get<std::string>(),
                                  printable(text_of(answer, "error", "no reason given"))),
                      "look at what the program printed");
      }
      const std::string lost = worker_->lost();
      const bool broke_protocol = worker_->broke_protocol();
      worker_.reset();
      if (broke_protocol) throw Failure(error_name_, lost, kAnswerAsAsked);
      throw_if_remembered(lost);
      if (attempt == kTries)
        throw Failure(error_name_, fmt::format("{}, {} times at one frame", lost, kTries),
                      "look at what the program printed");
      spdlog::warn("{} {}; starting it again", error_name_, lost);
    }
  }

  /// The array of a field. Failure if it is invalid or outside the answers' room.
  template <class T>
  Array<T> array(const json& answer, const char* field, std::size_t dimensions) const {
    constexpr const char* kType = std::is_same_v<T, float> ? "float32" : "int32";
    const auto fail = [&](const std::string& problem) {
      throw Failure(error_name_, fmt::format("answered with {} {}", field, problem),
                    fmt::format("give {{\"at\": byte, \"shape\": [{} lengths], \"type\": \"{}\"}} from "
                                "answer_at on, below size",
                                dimensions, kType));
    };
    const auto found = answer.find(field);
    if (found == answer.end() || !found->is_object()) fail("missing");
    const json at = found->value("at", json()), shape = found->value("shape", json());
    if (const json type = found->value("type", json(kType)); type != kType) fail("of type " + type.dump());
    if (!at.is_number_unsigned() || !shape.is_array() || shape.size() != dimensions)
      fail(fmt::format("at {} of shape {}", at.dump(), shape.dump()));
    Array<T> result;
    std::size_t count = 1;
    bool empty = false;
    for (const json& length : shape) {
      if (!length.is_number_unsigned()) fail("of shape " + shape.dump());
      result.shape.push_back(length.get<std::size_t>());
      empty = empty || result.shape.back() == 0;
      if (!empty && result.shape.back() > memory_.size() / count) fail("larger than the memory");
      count *= std::max<std::size_t>(result.shape.back(), 1);
    }
    const std::size_t from = at.get<std::size_t>();
    if (empty) return result;
    if (from < answer_at_ || from % sizeof(T) != 0 || from > memory_.size() ||
        count > (memory_.size() - from) / sizeof(T))
      fail(fmt::format("outside of its room (at {})", from));
    result.values = {reinterpret_cast<const T*>(memory_.data() + from), count};
    return result;
  }

  [[noreturn]] void not_finite(const char* field) const {
    throw Failure(error_name_, fmt::format("answered with {} that are not finite", field),
                  "look for logarithms, roots and divisions of 0");
  }

  /// The gradient of a sensor's data; zero if the program gives none.
  std::vector<float> take(const json& answer, const ExternalSensor& sensor) const {
    const auto group = answer.find(sensor.group());
    if (!sensor.sent || group == answer.end() || !group->is_object() || !group->contains(sensor.name) ||
        !group->at(sensor.name).is_object())
      return std::vector<float>(sensor.values());
    const std::string field = fmt::format("d_{}", sensor.array());
    const auto received = array<float>(group->at(sensor.name), field.c_str(), sensor.shape.size());
    if (received.shape != sensor.shape)
      throw Failure(error_name_,
                    fmt::format("gave a gradient of shape {} to {} of shape {}", json(received.shape).dump(),
                                sensor.name, json(sensor.shape).dump()),
                    "give one value for each that was sent");
    const std::span<const std::uint8_t> levels(
        reinterpret_cast<const std::uint8_t*>(memory_.data()) + sensor.at, received.values.size());
    std::vector<float> values;
    values.reserve(received.values.size());
    constexpr std::size_t kBlock = 4096;  // through the memory once: a block stays in the nearest cache
    while (values.size() < received.values.size()) {
      const std::size_t at = values.size(), count = std::min(kBlock, received.values.size() - at);
      const auto from = received.values.subspan(at, count);
      values.insert(values.end(), from.begin(), from.end());
      const auto here = std::span(values).subspan(at);
      if (sensor.kind == SensorData::Kind::camera && description_.bytes)
        through_srgb_slope(levels.subspan(at, count), here);
      if (!all_finite(here)) not_finite(field.c_str());
    }
    return values;
  }

  ProcessLimits limits_;
  std::vector<std::string> words_;
  SharedMemory memory_;
  json hello_, forward_;  ///< forward_: the last frame's job
  std::optional<JsonWorker> worker_;
  std::size_t d_logits_at_ = 0, answer_at_ = 0;
};

std::vector<InProcessDetector> in_force;

}  // namespace

ExternalDescription read_external_description(const nlohmann::json& description, const std::string& who) {
  using nlohmann::json;
  const auto bad = [&](const char* field, const std::string& problem, const char* fix) {
    throw FieldError("detector", who, std::string(field) + " " + problem, fix);
  };
  ExternalDescription word;
  Capabilities& can = word.can;
  const json reads = description.value("reads", json::array({"image", "points"}));
  const auto bad_reads = [&] {
    bad("reads", "is " + reads.dump(), "name image, points, or cameras beside the first");
  };
  if (!reads.is_array() || reads.empty()) bad_reads();
  can.reads_image = can.reads_points = false;
  for (const json& input : reads) {
    if (!input.is_string()) bad_reads();
    const auto name = input.get<std::string>();
    if (name == "image")
      can.reads_image = true;
    else if (name == "points")
      can.reads_points = true;
    else
      can.reads.push_back(name);
  }
  const auto said = [&](const char* key, const json& otherwise) {
    const json value = description.value(key, json());
    return value.is_null() ? otherwise : value;
  };
  const json finds = said("finds", "boxes"), pictures = said("pictures", "linear");
  can.version = text_of(description, "version", "");
  if (finds != "boxes" && finds != "picture") bad("finds", "is " + finds.dump(), "use boxes or picture");
  can.finds_bev = finds == "boxes", can.finds_picture = finds == "picture";
  if (pictures != "linear" && pictures != "srgb8")
    bad("pictures", "is " + pictures.dump(), "use linear or srgb8");
  word.bytes = pictures == "srgb8";
  const auto is_true = [&](const char* key) {
    const json value = said(key, false);
    if (!value.is_boolean()) bad(key, "is " + value.dump(), "use true or false");
    return value.get<bool>();
  };
  can.has_gradients = is_true("gradient");
  can.finds_heights = can.finds_bev && is_true("heights");
  can.remembers = is_true("remembers");
  can.why_whole = is_true("local") ? "" : "it knows no other passes";
  if (const json types = description.value("classes", json::array()); !types.empty()) {
    can.types.clear();
    for (const json& type : types)
      can.types.push_back(kitti_type(type.is_string() ? type.get<std::string>() : type.dump()));
  }
  if (const auto region = description.find("region"); region != description.end()) {
    const bool numbers =
        region->is_array() && region->size() == 4 &&
        std::all_of(region->begin(), region->end(), [](const json& v) { return v.is_number(); });
    for (std::size_t i = 0; numbers && i < 4; ++i) word.region[i] = (*region)[i].get<double>();
    if (!numbers || !(word.region[0] < word.region[1] && word.region[2] < word.region[3]))
      bad("region", "is " + region->dump(), "give x_min, x_max, y_min, y_max in m");
  }
  return word;
}

const float* first_value(const SensorData& sensor) {
  if (sensor.kind == SensorData::Kind::camera) return sensor.image->data.data();
  return sensor.kind == SensorData::Kind::lidar ? reinterpret_cast<const float*>(sensor.points.data())
                                                : sensor.values.data();
}

bool all_finite(std::span<const float> values) {
  std::uint32_t bad = 0;  // without a branch, so that it is quick
  for (const float value : values) bad |= (std::bit_cast<std::uint32_t>(value) & 0x7f800000u) == 0x7f800000u;
  return bad == 0;
}

bool BoxRows::knows(std::size_t columns, bool in_picture) {
  return in_picture ? columns == 4 : columns == 5 || columns == 7 || columns == 9;
}

const char* BoxRows::guide() {
  return "give boxes [M,5] (x, y, length, width in m, yaw in rad), [M,7] (x, y, z, length, width, height, "
         "yaw) or [M,9] (and vx, vy), for boxes in the picture [M,4], and logits [M]";
}

std::vector<Detection> BoxRows::proposals(const RawBoxes& raw, const Capabilities& can,
                                          double score_threshold, int width, int height,
                                          const std::string& who) {
  std::vector<Detection> answers;
  answers.reserve(raw.count);
  for (std::size_t i = 0; i < raw.count; ++i) {
    const int type = raw.classes.empty() ? 0 : raw.classes[i];
    if (type < 0 || as_size(type) >= can.types.size())
      throw InputError(who, fmt::format("box {} of {}", i, raw.count),
                       fmt::format("is of class {}, and {} are named", type, can.types.size()),
                       "name all classes in the order of their numbers");
    Detection& found =
        answers.emplace_back(detection_of(raw.boxes + i * raw.columns, raw.columns, !can.finds_bev));
    found.logit = raw.logits[i];
    found.type = type;
    if (!raw.identities.empty()) found.identity = raw.identities[i];
  }
  std::vector<Detection> kept = proposals(std::move(answers), score_threshold);
  check_proposals(kept, can.matching(), who);
  for (Detection& found : kept) found.picture = within(found.picture, width, height);
  return kept;
}

std::vector<Detection> BoxRows::proposals(std::vector<Detection> answers, double score_threshold) {
  count_ = answers.size();
  places_.clear();
  std::vector<Detection> kept;
  kept.reserve(count_);
  for (std::size_t i = 0; i < count_; ++i) {
    if (!(answers[i].score() > score_threshold)) continue;
    places_.push_back(i);
    kept.push_back(std::move(answers[i]));
  }
  return kept;
}

std::vector<float> BoxRows::of_rows(std::span<const double> d_logits) const {
  if (d_logits.size() > places_.size())
    throw Failure("backward",
                  fmt::format("{} values for {} proposals of the last pass", d_logits.size(), places_.size()),
                  "report this as a bug");
  std::vector<float> all(count_);
  for (std::size_t i = 0; i < d_logits.size(); ++i) all[places_[i]] = static_cast<float>(d_logits[i]);
  return all;
}

ExternalSensor::ExternalSensor(const SensorData& sensor, const Capabilities& reads)
    : name(sensor.name), kind(sensor.kind) {
  if (kind == SensorData::Kind::camera) {
    const bool saw = sensor.image && !sensor.image->empty();
    shape = {saw ? as_size(sensor.image->height) : 0, saw ? as_size(sensor.image->width) : 0, 3};
    sent = reads.reads_image && saw;
  } else if (kind == SensorData::Kind::lidar) {
    shape = {sensor.points.size(), 4};
    sent = reads.reads_points;
  } else {
    shape.assign(sensor.shape.begin(), sensor.shape.end() - (sensor.shape[2] == 0));
    sent = true;
  }
}

std::size_t ExternalSensor::values() const {
  return std::accumulate(shape.begin(), shape.end(), std::size_t{1}, std::multiplies<>());
}

const char* ExternalSensor::group() const {
  return std::array{"cameras", "lidars", "sensors"}[as_size(kind)];
}

const char* ExternalSensor::array() const {
  return std::array{"image", "points", "data"}[as_size(kind)];
}

json ExternalDetector::describe_input(const SensorView& view,
                                      const std::function<json(const SensorData&, ExternalSensor&)>& give) {
  const auto groups = [&](const std::vector<SensorData>& all, std::vector<ExternalSensor>& of) {
    json by_kind = {{"cameras", json::object()}, {"lidars", json::object()}, {"sensors", json::object()}};
    of.clear();
    for (const SensorData& sensor : all) {
      ExternalSensor& its = of.emplace_back(sensor, description_.can);
      json& description = by_kind[its.group()][its.name] = {{"time", sensor.time}};
      if (its.kind == SensorData::Kind::camera && view.calibration) {
        Calibration calibration;
        calibration.camera = sensor.camera, calibration.camera_from_velo = sensor.sensor_from_ego;
        description["pixel_from_velo"] = pixel_from_velo(calibration);
        description["intrinsics"] = {sensor.camera.fx, sensor.camera.fy, sensor.camera.cx, sensor.camera.cy};
      }
      if (its.kind != SensorData::Kind::lidar && view.calibration)
        description["sensor_from_ego"] = rows_json(sensor.sensor_from_ego);
      if (its.sent) description[its.array()] = give(sensor, its);
    }
    return by_kind;
  };
  json job = groups(sensors(view, description_.can, error_name_), sensors_);
  if (view.clean && description_.can.why_whole.empty() &&
      view.others.empty()) {  // the changes of others are unknown
    SensorView before = view;
    before.image = view.clean->image, before.points = view.clean->points, before.clean = nullptr;
    std::vector<ExternalSensor> without;
    json& clean = job["clean"] = groups(sensors(before, description_.can, error_name_), without);
    clean["key"] = fmt::format("{:016x}", view.clean->key);
    for (const ExternalSensor& sensor : without) {
      if (sensor.kind != SensorData::Kind::camera) continue;
      const PixelRect changed = &sensor == &without.front() ? view.clean->changed : PixelRect();
      clean["cameras"][sensor.name]["changed"] = {changed.u0, changed.v0, changed.u1, changed.v1};
    }
  }
  job["frame"] = view.frame ? escape_name(view.frame->id) : "";
  job["continues"] = view.continues;
  if (view.frame && view.frame->moment) {
    const Moment& moment = *view.frame->moment;
    job["moment"] = {{"sequence", escape_name(moment.sequence)},
                     {"index", moment.index},
                     {"time", moment.time},
                     {"world_from_ego", rows_json(moment.world_from_ego)}};
  }
  return job;
}

SensorGradient ExternalDetector::gradient(
    const std::function<std::vector<float>(const ExternalSensor&)>& of) const {
  SensorGradient gradient;
  for (std::size_t i = 0; i < sensors_.size(); ++i) {
    const ExternalSensor& sensor = sensors_[i];
    std::vector<float> values = of(sensor);
    if (i == 0) {
      gradient.image.width = static_cast<int>(sensor.shape[1]);
      gradient.image.height = static_cast<int>(sensor.shape[0]);
      gradient.image.channels = 3;
      gradient.image.data = std::move(values);
    } else if (i == 1) {
      gradient.points.resize(sensor.shape[0]);
      if (!values.empty()) std::copy(values.begin(), values.end(), gradient.points.front().data());
    } else {
      gradient.others[sensor.name] = std::move(values);
    }
  }
  return gradient;
}

void ExternalDetector::throw_if_blind(const SensorView& view, const char* why) const {
  if (description_.can.reads_image && (!view.image || view.image->empty()))
    throw InputError("detector", "image", std::string("cannot do without a picture (") + why + ")",
                     "give it one");
}

bool is_program(const std::string& detector) {
  return detector.starts_with(kProgramPrefix);
}

std::string program_hash(const std::string& detector) {
  const std::vector<std::string> words = command_words(detector);
  std::string all;
  std::vector<std::string> uncounted;
  bool python = false;
  for (std::size_t i = 0; i < words.size(); ++i) {
    const NamedByWord named = named_by(words[i]);
    const std::string name = words[i].substr(named.at);
    python = python || std::filesystem::path(name).filename().string().starts_with("python");
    const bool is_file = named.type == std::filesystem::file_type::regular;
    if (!is_file &&
        (named.type == std::filesystem::file_type::directory || (python && i > 0 && words[i - 1] == "-m")))
      uncounted.push_back(name);
    all += escape_name(words[i].substr(0, named.at));
    all += is_file ? file_hash(name) : escape_name(name);
    all += "\n";
  }
  warn_of_uncounted(detector, uncounted);
  return "program-" + content_hash(all);
}

std::unique_ptr<Detector> start_program(const DetectorOptions& options, const ProcessLimits& limits) {
  return std::make_unique<ProcessDetector>(options, limits);
}

ScopedDetectors::ScopedDetectors(std::vector<InProcessDetector> detectors) {
  if (!in_force.empty())
    throw Failure("detector", "another call with a detector of the program's own is still running",
                  "wait for it, or use another process");
  in_force = std::move(detectors);
}

ScopedDetectors::~ScopedDetectors() {
  in_force.clear();
}

bool is_in_process(const DetectorOptions& options) {
  return options.detector == kInProcessDetector || options.detector == kSecondInProcessDetector;
}

bool is_outside(const DetectorOptions& options) {
  return is_in_process(options) || is_program(options.detector);
}

std::string outside_content(const DetectorOptions& options) {
  if (is_program(options.detector)) return program_hash(options.detector);
  const InProcessDetector* in_process = in_process_detector(options);
  return in_process ? in_process->content : "";
}

const InProcessDetector* in_process_detector(const DetectorOptions& options) {
  const std::size_t which = options.detector == kSecondInProcessDetector ? 1 : 0;
  return is_in_process(options) && which < in_force.size() ? &in_force[which] : nullptr;
}

}  // namespace mirage
