#include "validation/blender/blender_process.h"

#include <fmt/format.h>

#include <algorithm>

#include "base/error.h"
#include "base/fields.h"
#include "base/files.h"
#include "base/image.h"
#include "base/logging.h"
#include "base/memory.h"
#include "base/names.h"
#include "base/parallel.h"
#include "base/ranks.h"
#include "base/sizes.h"
#include "exchange/gltf.h"
#include "exchange/mesh_files.h"
#include "validation/reference/host_scene.h"

namespace mirage {
namespace {

constexpr double kRenderTimeout = 900;  // s; a crop takes seconds

/// The named channels of a multilayer EXR ("Combined.R": the layer's name comes before); empty if the file
/// lacks them.
ImageF read_channels(const std::filesystem::path& file, PictureSize size,
                     const std::vector<std::string>& names) {
  std::vector<std::string> there;
  ImageF all;
  try {
    all = read_exr(file, size, &there);
  } catch (const InputError&) {  // which would put it down to the user
    throw Failure(file.string(),
                  "Blender's picture is cut short, damaged or not of the size that was asked for",
                  "free some space and run again, or look at blender.log");
  }
  ImageF image(size.width, size.height, static_cast<int>(names.size()));
  for (std::size_t c = 0; c < names.size(); ++c) {
    int channel = -1;
    for (int k = 0; k < all.channels; ++k)
      if (there[as_size(k)].ends_with("." + names[c])) channel = k;
    if (channel < 0) return {};
    for (std::size_t i = 0; i < image.data.size() / names.size(); ++i)
      image.data[i * names.size() + c] = all.data[i * as_size(all.channels) + as_size(channel)];
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
    throw FieldError("out", out.string(), "is not text (UTF-8), and Blender is told of it in JSON",
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
    child_ = std::make_unique<JsonWorker>(
        std::vector<std::string>{"/usr/bin/env", "-u", "PYTHONHOME", "-u", "PYTHONPATH", "PATH=/usr/bin:/bin",
                                 "BLENDER_USER_SCRIPTS=" + nowhere, "BLENDER_USER_CONFIG=" + nowhere,
                                 program_.string(), "-b", "--factory-startup", "--disable-autoexec",
                                 "--python-exit-code", "1", "-P", script_.string(), "--"},
        log_, "Blender was rendering");
    if (child_->exchange({{"job", "ping"}}, start_timeout_, answer, true)) break;
    const std::string lost = child_->lost();
    const bool dies = child_->end().has_value();  // one that is silent would only be waited for again
    child_.reset();
    if (!dies || attempt == kAttempts)
      throw Failure(
          program_.string(),
          dies ? fmt::format("{} while starting, {} times", lost, kAttempts) : "does not answer: it " + lost,
          "look at " + log_.string());
    spdlog::warn("Blender {} while starting; starting it again", lost);
    ++restarts_;
  }
  version_ = text_of(answer, "version", "");
}

nlohmann::json BlenderWorker::request(nlohmann::json job, double timeout) {
  nlohmann::json answer;
  for (int attempt = 1;; ++attempt) {
    if (child_ && child_->exchange(job, timeout, answer)) break;
    losses_.push_back({job.value("job", ""), child_ ? child_->lost() : losses_.back().how, attempt});
    child_.reset();
    if (attempt < kAttempts) spdlog::warn("Blender {}; starting it again", losses_.back().how);
    ++restarts_;
    start();
    if (attempt == kAttempts)
      throw ReferenceLost(
          program_.string(),
          fmt::format("{}, {} times on one job ({})", losses_.back().how, kAttempts, losses_.back().job),
          "look at " + log_.string());
  }
  if (!answer["ok"].get<bool>())
    throw Failure("blender", text_of(answer, "error", "unknown error"), "look at " + log_.string());
  return answer;
}

Rendered BlenderWorker::render(const RenderJob& job) {
  std::error_code ignored;
  std::filesystem::remove(job.output, ignored);
  const auto answer = request({{"job", "render"},
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

std::vector<double> BlenderWorker::raycast(const std::filesystem::path& scene, std::span<const LidarRay> rays,
                                           const std::filesystem::path& scratch) {
  std::vector<double> flat;
  for (const LidarRay& ray : rays)
    for (const Vec3d& v : {ray.origin, ray.direction}) flat.insert(flat.end(), v.data(), v.data() + 3);
  const auto in = scratch / "rays.bin", out = scratch / "ranges.bin";
  write_file(in, {reinterpret_cast<const char*>(flat.data()), flat.size() * sizeof(double)});
  request({{"job", "raycast"},
           {"scene", std::filesystem::absolute(scene).string()},
           {"rays", std::filesystem::absolute(in).string()},
           {"output", std::filesystem::absolute(out).string()}},
          120);
  const std::string bytes = read_file(out);
  std::vector<double> ranges(rays.size());
  if (bytes.size() != ranges.size() * sizeof(double))
    throw Failure(out.string(), "has the wrong size", "free some space and run again");
  copy_bytes(ranges.data(), bytes.data(), bytes.size());
  return ranges;
}

void BlenderWorker::write_fbx(const std::filesystem::path& file, const TexturedMesh& adversary) {
  namespace fs = std::filesystem;
  constexpr double kTimeout = 300;  // s; it takes one or two
  const auto beside = [&](const char* extension) {
    return fs::absolute(file).parent_path() / fmt::format(".{}.part{}", file.stem().string(), extension);
  };
  const fs::path mesh = beside(".glb"), fbx = beside(".fbx");
  struct Remove {
    const fs::path& file;
    ~Remove() {
      std::error_code ignored;
      fs::remove(file, ignored);
    }
  } const mesh_after{mesh}, fbx_after{fbx};
  write_adversary(mesh, standing_on_origin(adversary));
  request({{"job", "fbx"}, {"mesh", mesh.string()}, {"output", fbx.string()}}, kTimeout);
  replace_file(fbx, file);
}

ReferenceIdentity BlenderWorker::identity() const {
  return {"blender", "Blender Cycles", version_, renderer_programs()};
}

std::unique_ptr<ReferenceRenderer> start_blender(const std::filesystem::path& out, const std::string& log,
                                                 const std::string& program) {
  require_text_path(out);
  make_output_folder(out);
  return std::make_unique<BlenderWorker>(out / log, program);
}

namespace fs = std::filesystem;

CyclesRenderer::CyclesRenderer(const Settings& settings)
    : settings_(settings), workers_(as_size(std::max(1, settings.workers))) {
  start(0);
  reference_ = workers_[0].blender->identity();
}

CyclesRenderer::~CyclesRenderer() {
  std::error_code ignored;
  for (const Worker& worker : workers_)
    if (!worker.scratch.empty()) fs::remove_all(worker.scratch, ignored);
  fs::remove(settings_.out / kScratchFolder, ignored);  // if no other process draws there
}

void CyclesRenderer::start(std::size_t index) {
  const std::string name =
      as_size(rank_count()) * workers_.size() > 1 ? fmt::format("-{}-{}", rank(), index) : "";
  Worker& worker = workers_[index];
  worker.blender = start_blender(settings_.out, fmt::format("blender{}.log", name), settings_.program);
  worker.scratch = settings_.out / kScratchFolder / ("cycles" + name);
  fs::create_directories(worker.scratch);
}

CyclesRenderer::Lease CyclesRenderer::take() {
  std::unique_lock lock(mutex_);
  for (;;) {
    for (const bool running : {true, false})  // one that waits rather than one that has to start
      for (std::size_t i = 0; i < workers_.size(); ++i) {
        Worker& worker = workers_[i];
        if (worker.busy || (worker.blender != nullptr) != running) continue;
        worker.busy = true;
        ++drawn_;
        lock.unlock();
        Lease lease(&worker, [this](Worker* used) {
          {
            const std::scoped_lock free(mutex_);
            used->busy = false;
          }
          given_.notify_one();
        });
        if (!running) start(i);
        return lease;
      }
    given_.wait(lock);
  }
}

ObjectRenderer::Window CyclesRenderer::draw(const HostInWorld& host, const TexturedMesh& adversary,
                                            const Simulated& simulated, std::uint64_t seed) {
  const Frame& frame = host.prepared.frame;
  HostScene scene = scene_of(host, adversary);
  scene.samples = settings_.samples;
  scene.seed = seed;
  ExportScene file = host_scene(frame, scene.placement, adversary, host_name(host.host));
  file.photograph = {};  // laid under the render here
  Window window{full_rect(simulated, frame.image), {}};
  window.picture = crop(frame.image, window.rect);
  const ImageF visible = visible_share(scene, window.rect);
  Lease worker = take();
  scene.scratch = worker->scratch;
  scene.glb = worker->scratch / "scene.glb";
  write_scene(scene.glb, file);
  RenderJob job = job_for(scene, window.rect);
  job.effects = full_effects();
  job.threads = std::max(1, thread_count() / static_cast<int>(workers_.size()));
  const Rendered rendered = worker->blender->render(job);
  worker.reset();
  composite(rendered, visible, window.picture);
  return window;
}

nlohmann::json CyclesRenderer::identity() const {
  std::string programs;
  for (const fs::path& program : reference_.programs) programs += file_hash(program);
  return {{"name", "cycles"},
          {"samples", settings_.samples},
          {reference_.key, reference_.version},
          {"programs", content_hash(programs)}};
}

}  // namespace mirage
