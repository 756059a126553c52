#include "validation/blender/blender_process.h"

#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include <algorithm>
#include <cstring>

#include "base/clock.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/image_io.h"
#include "base/interrupt.h"
#include "base/json_depth.h"
#include "base/logging.h"
#include "base/names.h"

namespace mirage {
namespace {

constexpr double kRenderTimeout = 900;  // s; a crop takes seconds
constexpr const char* kEnded = "ended unexpectedly";

/// One line of what Blender said, for a message.
std::string shown(const std::string& line) {
  std::string text = line.substr(0, 60);
  for (char& c : text)
    if (c < ' ' || c > '~') c = '?';
  return "'" + text + (line.size() > 60 ? "…'" : "'");
}

std::string text_of(const nlohmann::json& answer, const char* key, const std::string& otherwise) {
  const auto field = answer.find(key);
  return field != answer.end() && field->is_string() ? field->get<std::string>() : otherwise;
}

/// Whether a line is the protocol's answer to job `id`.
bool is_answer(const std::string& line, long id, nlohmann::json& answer) {
  try {
    check_json_depth(line, "blender");
  } catch (const InputError&) {
    return false;
  }
  answer = nlohmann::json::parse(line, nullptr, false);
  if (!answer.is_object() || !answer.contains("id") || !answer.contains("ok")) return false;
  return answer["id"].is_number_integer() && answer["id"].get<long>() == id && answer["ok"].is_boolean();
}

/// The named channels of a multilayer EXR ("Combined.R": the layer's name comes before); empty if it has
/// none.
ImageF read_channels(const std::filesystem::path& file, PictureSize size,
                     const std::vector<std::string>& names) {
  auto input = OIIO::ImageInput::open(file.string());
  if (!input) throw Failure(file.string(), "not readable (" + OIIO::geterror() + ")", "look at blender.log");
  const OIIO::ImageSpec& spec = input->spec();
  if (spec.width != size.width || spec.height != size.height)
    throw Failure(file.string(),
                  fmt::format("is {}×{}, not {}×{}", spec.width, spec.height, size.width, size.height),
                  "use Blender 3.4 to 4.3");
  std::vector<float> all(static_cast<std::size_t>(spec.width) * spec.height * spec.nchannels);
  if (!input->read_image(0, 0, 0, spec.nchannels, OIIO::TypeDesc::FLOAT, all.data()))
    throw Failure(file.string(), "cut short, as by a full disk", "free some space and run again");
  ImageF image(spec.width, spec.height, static_cast<int>(names.size()));
  for (std::size_t c = 0; c < names.size(); ++c) {
    int channel = -1;
    for (int k = 0; k < spec.nchannels; ++k)
      if (spec.channelnames[k].ends_with("." + names[c])) channel = k;
    if (channel < 0) return {};
    for (std::size_t i = 0; i < image.data.size() / names.size(); ++i)
      image.data[i * names.size() + c] = all[i * spec.nchannels + channel];
  }
  return image;
}

nlohmann::json effects_json(const RenderEffects& effects) {
  static const char* const kSurroundings[] = {"none", "unseen", "catcher"};
  return {{"shadows", effects.shadows},
          {"sky", effects.sky},
          {"bounces", effects.bounces},
          {"specular", effects.specular},
          {"paint", effects.paint},
          {"clear_sky", effects.clear_sky},
          {"surroundings", kSurroundings[static_cast<int>(effects.surroundings)]}};
}

}  // namespace

std::vector<std::filesystem::path> renderer_programs() {
  std::vector<std::filesystem::path> files;
  const std::filesystem::path package =
      shipped_file("plugins/blender/mirage_blender/__init__.py").parent_path();
  for (const auto& entry : std::filesystem::directory_iterator(package))
    if (entry.path().extension() == ".py") files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  for (const char* script : {"validation/blender/blender_worker.py", "validation/blender/physical_light.py"})
    files.push_back(shipped_file(script));
  return files;
}

void require_text_path(const std::filesystem::path& out) {
  if (printable(out.string()) != out.string())
    throw FieldError("out", out.string(), "is no text (UTF-8), and Blender is told of it in JSON",
                     "choose another folder");
}

BlenderWorker::BlenderWorker(std::filesystem::path log, std::string program, double start_timeout)
    : log_(std::move(log)), program_(find_program(program)), start_timeout_(start_timeout) {
  if (program_.empty())
    throw InputError(program, "", "not found on PATH", "install it with apt-get install blender");
  script_ = shipped_file("validation/blender/blender_worker.py");
  start();
}

BlenderWorker::~BlenderWorker() {
  if (child_) child_->stop(interrupted() ? 0 : 2);
}

void BlenderWorker::start() {
  // Blender's Python finds its home through the first python3 on PATH, which a pyenv or a virtual environment
  // turns into one without numpy; user scripts are kept out as well.
  const std::string nowhere = (log_.parent_path() / "no-user-scripts").string();
  nlohmann::json answer;
  for (int attempt = 1;; ++attempt) {
    child_ = std::make_unique<ChildProcess>(
        std::vector<std::string>{"/usr/bin/env", "-u", "PYTHONHOME", "-u", "PYTHONPATH", "PATH=/usr/bin:/bin",
                                 "BLENDER_USER_SCRIPTS=" + nowhere, "BLENDER_USER_CONFIG=" + nowhere,
                                 program_.string(), "-b", "--factory-startup", "--disable-autoexec",
                                 "--python-exit-code", "1", "-P", script_.string(), "--"},
        log_);
    if (exchange({{"job", "ping"}}, start_timeout_, answer, true)) break;
    child_.reset();
    const bool dies = lost_ == kEnded;  // one that is silent would only be waited for again
    if (!dies || attempt == kAttempts)
      throw Failure(program_.string(),
                    dies ? fmt::format("{} while starting, {} times", lost_, kAttempts)
                         : "does not answer: it " + lost_,
                    "look at " + log_.string());
    spdlog::warn("Blender {} while starting; starting it again", lost_);
    ++restarts_;
  }
  version_ = text_of(answer, "version", "");
}

bool BlenderWorker::exchange(const nlohmann::json& job, double timeout, nlohmann::json& answer,
                             bool starting) {
  nlohmann::json message = job;
  message["id"] = ++next_id_;
  lost_ = kEnded;
  if (!child_->write_line(message.dump())) return false;
  const auto asked = Clock::now();
  for (std::string line;;) {
    switch (child_->read_line(line, timeout - seconds_since(asked))) {
      case ChildProcess::Read::line:
        break;
      case ChildProcess::Read::interrupted:
        throw Interrupted(
            "stopped while Blender was rendering; what is finished is kept, run again to go on");
      case ChildProcess::Read::timed_out:
        lost_ = fmt::format("gave no answer in {:g} s", timeout);
        return false;
      case ChildProcess::Read::endless:
        lost_ = "gave an answer without end";
        return false;
      default:
        return false;
    }
    if (is_answer(line, next_id_, answer)) return true;
    if (!starting) {
      lost_ = fmt::format("gave a malformed answer ({})", shown(line));
      return false;
    }
  }
}

nlohmann::json BlenderWorker::request(nlohmann::json job, double timeout) {
  nlohmann::json answer;
  for (int attempt = 1;; ++attempt) {
    if (child_ && exchange(job, timeout, answer)) break;
    losses_.push_back({job.value("job", ""), lost_, attempt});
    child_.reset();
    if (attempt < kAttempts) spdlog::warn("Blender {}; starting it again", lost_);
    ++restarts_;
    start();
    if (attempt == kAttempts)
      throw BlenderLost(
          program_.string(),
          fmt::format("{}, {} times on one job ({})", losses_.back().how, kAttempts, losses_.back().job),
          "look at " + log_.string());
  }
  if (!answer["ok"].get<bool>())
    throw Failure("blender", text_of(answer, "error", "unknown error"), "look at " + log_.string());
  return answer;
}

Rendered render(BlenderWorker& blender, const RenderJob& job) {
  std::error_code ignored;
  std::filesystem::remove(job.output, ignored);
  const auto answer = blender.request({{"job", "render"},
                                       {"scene", std::filesystem::absolute(job.scene).string()},
                                       {"output", std::filesystem::absolute(job.output).string()},
                                       {"rect", {job.rect.u0, job.rect.v0, job.rect.u1, job.rect.v1}},
                                       {"samples", job.samples},
                                       {"seed", job.seed},
                                       {"threads", job.threads},
                                       {"pixel", job.pixel_centre ? "centre" : "area"},
                                       {"filter_width", job.filter_width},
                                       {"effects", effects_json(job.effects)}},
                                      kRenderTimeout);
  Rendered result;
  result.seconds =
      answer.contains("seconds") && answer["seconds"].is_number() ? answer["seconds"].get<double>() : 0;
  const PictureSize size{job.rect.width(), job.rect.height()};
  result.rgba = read_channels(job.output, size, {"Combined.R", "Combined.G", "Combined.B", "Combined.A"});
  if (result.rgba.empty()) throw Failure(job.output.string(), "has no picture", "use Blender 3.4 to 4.3");
  if (job.effects.surroundings == RenderEffects::Surroundings::catcher) {
    result.catcher =
        read_channels(job.output, size, {"Shadow Catcher.R", "Shadow Catcher.G", "Shadow Catcher.B"});
    if (result.catcher.empty())
      throw Failure(job.output.string(), "has no shadow catcher pass", "use Blender 3.4 to 4.3");
  }
  return result;
}

std::vector<double> raycast(BlenderWorker& blender, const std::filesystem::path& scene,
                            std::span<const LidarRay> rays, const std::filesystem::path& scratch) {
  std::vector<double> flat;
  for (const LidarRay& ray : rays)
    for (const Vec3d& v : {ray.origin, ray.direction}) flat.insert(flat.end(), v.data(), v.data() + 3);
  const auto in = scratch / "rays.bin", out = scratch / "ranges.bin";
  write_file(in, {reinterpret_cast<const char*>(flat.data()), flat.size() * sizeof(double)});
  blender.request({{"job", "raycast"},
                   {"scene", std::filesystem::absolute(scene).string()},
                   {"rays", std::filesystem::absolute(in).string()},
                   {"output", std::filesystem::absolute(out).string()}},
                  120);
  const std::string bytes = read_file(out);
  std::vector<double> ranges(rays.size());
  if (bytes.size() != ranges.size() * sizeof(double))
    throw Failure(out.string(), "has the wrong size", "free some space and run again");
  if (!ranges.empty()) std::memcpy(ranges.data(), bytes.data(), bytes.size());
  return ranges;
}

}  // namespace mirage
