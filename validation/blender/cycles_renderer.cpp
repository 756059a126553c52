#include "validation/blender/cycles_renderer.h"

#include <fmt/format.h>

#include <algorithm>

#include "base/files.h"
#include "base/parallel.h"
#include "base/ranks.h"
#include "exchange/host_proxy.h"
#include "validation/blender/blender_process.h"
#include "validation/reference/host_scene.h"
#include "validation/reference/reference_renderer.h"

namespace mirage {

namespace fs = std::filesystem;

CyclesRenderer::CyclesRenderer(const Settings& settings)
    : settings_(settings), workers_(static_cast<std::size_t>(std::max(1, settings.workers))) {
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
  const std::string name = rank_count() * workers_.size() > 1 ? fmt::format("-{}-{}", rank(), index) : "";
  Worker& worker = workers_[index];
  worker.blender = start_blender(settings_.out, fmt::format("blender{}.log", name), settings_.program);
  worker.scratch = settings_.out / kScratchFolder / ("cycles" + name);
  fs::create_directories(worker.scratch);
}

CyclesRenderer::Worker& CyclesRenderer::take() {
  std::unique_lock lock(mutex_);
  for (;;) {
    for (const bool running : {true, false})  // one that waits rather than one that has to start
      for (std::size_t i = 0; i < workers_.size(); ++i) {
        Worker& worker = workers_[i];
        if (worker.busy || (worker.blender != nullptr) != running) continue;
        worker.busy = true;
        ++drawn_;
        lock.unlock();
        if (running) return worker;
        try {
          start(i);
        } catch (...) {
          give(worker);
          throw;
        }
        return worker;
      }
    given_.wait(lock);
  }
}

void CyclesRenderer::give(Worker& worker) {
  {
    const std::scoped_lock lock(mutex_);
    worker.busy = false;
  }
  given_.notify_one();
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
  Worker& worker = take();
  Rendered rendered;
  try {
    scene.scratch = worker.scratch;
    scene.glb = worker.scratch / "scene.glb";
    write_scene(scene.glb, file);
    RenderJob job = job_for(scene, window.rect);
    job.effects = full_effects();
    job.threads = std::max(1, thread_count() / static_cast<int>(workers_.size()));
    rendered = worker.blender->render(job);
  } catch (...) {
    give(worker);
    throw;
  }
  give(worker);
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
