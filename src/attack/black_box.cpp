#include "attack/black_box.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <pagmo/algorithms/cmaes.hpp>
#include <pagmo/population.hpp>
#include <pagmo/problem.hpp>

#include "attack/baseline.h"
#include "attack/run.h"
#include "base/error.h"
#include "base/files.h"
#include "base/json_fields.h"
#include "base/logging.h"
#include "base/provenance.h"
#include "base/random.h"
#include "base/ranks.h"
#include "base/schedule.h"
#include "base/sizes.h"
#include "geometry/mesh.h"

namespace mirage {

void check_search(const AttackSettings& settings) {
  if (settings.attack == AttackSearch::plain) return;
  const auto refuse = [&](const char* field, const std::string& value, const char* why, const char* fix) {
    throw FieldError(field, value,
                     fmt::format("does not go with --attack {}: {}", to_word(settings.attack), why), fix);
  };
  const bool black_box = settings.attack == AttackSearch::black_box;
  if (settings.target == AttackTarget::random)
    refuse("target", "random", "nothing is learned", "leave --attack out");
  if (black_box && settings.target != AttackTarget::both)
    refuse("target", to_word(settings.target), "no sensor has a gradient", "leave --target out");
  if (settings.until_plateau > 0)
    refuse("until_plateau", std::to_string(settings.until_plateau),
           black_box ? "it spends all of its --queries" : "it spends all of its --iterations",
           "leave --until-plateau out");
  if (settings.renderer)
    refuse("renderer", "cycles", "its candidates would need pictures of each", "use --renderer raster");
  if (settings.seconds > 0)
    refuse("seconds", fmt::format("{}", settings.seconds),
           black_box ? "its budget is in queries" : "its budget is in steps",
           black_box ? "use --queries" : "use --iterations");
}

bool learns_shape(const AttackSettings& settings) {
  return settings.parts == AttackParts::both || settings.parts == AttackParts::shape;
}

bool sees_colours(const AttackSettings& settings, const Capabilities& can) {
  const bool both = settings.target == AttackTarget::both;
  const bool returns = both || settings.target == AttackTarget::lidar;
  const bool picture = both || settings.target == AttackTarget::image;
  return (picture && can.reads_image) ||
         (returns && can.reads_points && settings.simulation.lidar_effects.albedo) ||
         (both && !settings.sensors.empty() && !can.reads.empty());
}

std::vector<NamedStart> search_starts(const AttackSettings& settings) {
  std::vector<NamedStart> starts{{"paper", fresh_state(settings).adversary}};
  if (learns_shape(settings))
    for (const Baseline kind : {Baseline::ellipsoid, Baseline::cuboid})
      starts.push_back({to_word(kind), filling_shape(kind, settings.limits, settings.buildable)});
  return starts;
}

std::vector<Host> search_hosts(std::vector<Host> hosts, std::uint64_t seed) {
  RandomStream random(seed, "search hosts");
  shuffle(hosts, random);
  hosts.resize(std::min(hosts.size(), kSearchHosts));
  return hosts;
}

struct Evolution::Method {
  /// The points that pagmo evaluates in a generation, and the values it gets. It requests a whole generation
  /// before it uses any value, so a copy that gets zeros reveals the next generation.
  struct Requests {
    std::vector<std::vector<double>> points;
    std::vector<double> fitness_values;
  };
  /// The function as pagmo sees it.
  struct GenerationFunction {
    std::shared_ptr<Requests> requests;
    std::size_t numbers = 1;

    pagmo::vector_double fitness(const pagmo::vector_double& at) const {
      const std::size_t i = requests->points.size();
      requests->points.push_back(at);
      return {i < requests->fitness_values.size() ? requests->fitness_values[i] : 0};
    }
    /// pagmo's initial standard deviations are the widths of these bounds.
    std::pair<pagmo::vector_double, pagmo::vector_double> get_bounds() const {
      return {pagmo::vector_double(numbers, -0.5), pagmo::vector_double(numbers, 0.5)};
    }
  };

  Method(std::size_t numbers, std::uint64_t seed)
      : method(1, kOwn, kOwn, kOwn, kOwn, /*sigma0=*/1, /*ftol=*/0, /*xtol=*/0, /*memory=*/true,
               /*force_bounds=*/false, RandomStream(seed, "evolution").next_u32()),
        population(pagmo::problem(GenerationFunction{requests, numbers})) {}

  static constexpr double kOwn = -1;  // pagmo's default rates
  std::shared_ptr<Requests> requests = std::make_shared<Requests>();
  pagmo::cmaes method;  // runs one generation a call
  pagmo::population population;
};

Evolution::Evolution(std::size_t numbers, int samples, std::uint64_t seed)
    : method_(std::make_unique<Method>(numbers, seed)), centre_(numbers, 0.0) {
  for (int i = 0; i < samples; ++i) method_->population.push_back(centre_, {0.0});
  draw();
}

Evolution::~Evolution() = default;

void Evolution::draw() {
  *method_->requests = {};
  const pagmo::cmaes copy = method_->method;
  copy.evolve(method_->population);
  generation_ = method_->requests->points;
}

const std::vector<double>& Evolution::next() const {
  return generation_[values_.size()];
}

void Evolution::add(double value) {
  values_.push_back(value);
  if (values_.size() < generation_.size()) return;
  *method_->requests = {{}, values_};
  method_->population = method_->method.evolve(method_->population);
  std::vector<std::size_t> order(values_.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::stable_sort(order, {}, [&](std::size_t i) { return values_[i]; });
  order.resize(order.size() / 2);  // pagmo does not expose its mean; this recomputes it
  double sum = 0;
  std::fill(centre_.begin(), centre_.end(), 0.0);
  for (std::size_t rank = 0; rank < order.size(); ++rank) {
    const double weight =
        std::log((static_cast<double>(order.size()) + 0.5) / (static_cast<double>(rank) + 1));
    sum += weight;
    for (std::size_t i = 0; i < centre_.size(); ++i) centre_[i] += weight * generation_[order[rank]][i];
  }
  for (double& x : centre_) x /= sum;
  values_.clear();
  draw();
}

namespace {

constexpr int kModeDegree = 2;
/// Initial standard deviations of a search: of log sizes, of displacements in half lengths of the box, and of
/// colour logits.
constexpr double kSize = 0.2, kWarp = 0.2, kColour = 1.5;
/// Keeps the logits of black and white colours finite.
constexpr double kMinColour = 1e-3;

/// Legendre polynomials of degree 0 … kModeDegree.
std::array<double, kModeDegree + 1> legendre(double t) {
  std::array<double, kModeDegree + 1> p{1, t};
  for (int n = 1; n < kModeDegree; ++n) {
    const auto i = as_size(n);
    p[i + 1] = ((2 * n + 1) * t * p[i] - n * p[i - 1]) / (n + 1);
  }
  return p;
}

enum class Axis { x, y, z, colour };

/// Products of total degree ≤ kModeDegree: odd in y along y, otherwise even; without the mode that stretches
/// the axis.
std::vector<double> modes(const Vec3d& u, Axis axis) {
  const auto px = legendre(u.x()), py = legendre(u.y()), pz = legendre(u.z());
  std::vector<double> values;
  for (std::size_t j = axis == Axis::y ? 1 : 0; j <= kModeDegree; j += 2)
    for (std::size_t i = 0; i + j <= kModeDegree; ++i)
      for (std::size_t k = 0; i + j + k <= kModeDegree; ++k) {
        const bool linear = i + j + k == 1;
        if (linear && ((axis == Axis::x && i == 1) || axis == Axis::y || (axis == Axis::z && k == 1)))
          continue;
        values.push_back(px[i] * py[j] * pz[k]);
      }
  return values;
}

/// Version of this file's mesh construction: a folder of another version cannot be resumed.
constexpr int kBlackBoxRecipe = 2;
/// Worlds for the whole sample, which no generation uses.
constexpr std::uint64_t kSampleWorlds = std::uint64_t{1} << 61;

class BlackBox {
 public:
  explicit BlackBox(const SearchRun& run)
      : run_(run),
        settings_(run.settings),
        file_(settings_.out / "checkpoint.json"),
        sample_(search_hosts(run.train, settings_.seed)),
        starts_(search_starts(settings_)),
        identity_(run.identity),
        timer_(settings_.checkpoint),
        progress_("attack", as_size(settings_.queries), settings_.quiet),
        plan_(black_box_plan(settings_, starts_.size(), modes_of(starts_.front().mesh).size(),
                             sample_.size())) {
    identity_.json["recipe"] = kBlackBoxRecipe;
  }

  SearchOutcome run() {
    open();
    SearchOutcome outcome;
    outcome.first = std::ssize(rows_);
    NamedStart& start = judge_starts();
    const MeshModes modes = modes_of(start.mesh);
    const auto made = [&](std::span<const double> numbers) {
      TexturedMesh mesh = modes.mesh(numbers);
      if (settings_.buildable.on) keep_buildable(mesh, start.mesh, settings_.buildable, settings_.limits);
      return mesh;
    };
    const AttackStepper stepper = stepper_of(start.mesh);
    Evolution evolution(modes.size(), plan_.samples, settings_.seed);
    const HostOrder order(sample_, settings_.batch, settings_.seed);
    const auto evaluated = std::ssize(rows_) - std::ssize(starts_);
    const long meshes = std::max(plan_.generations, evaluated / plan_.samples) * plan_.samples;
    for (long i = 0; i < meshes; ++i) {
      const long generation = i / plan_.samples;
      if (i == std::ssize(rows_) - std::ssize(starts_)) {
        std::vector<Host> hosts;
        for (const std::size_t k : order.batch(generation)) hosts.push_back(sample_[k]);
        evaluate(stepper, made(evolution.next()), hosts,
                 static_cast<std::uint64_t>(generation) * static_cast<std::uint64_t>(settings_.batch),
                 fmt::format("generation {} of {}", generation + 1, meshes / plan_.samples));
      }
      evolution.add(rows_[starts_.size() + as_size(i)].loss());
    }
    TexturedMesh arrived = made(evolution.centre());
    const double value = stepper.judge(arrived, sample_, kSampleWorlds, &stages_).loss();
    spdlog::info("searched from {}: {:.4f} after {} generations, {:.4f} at the start, on {} vehicles",
                 start.name, value, meshes / plan_.samples, start.value, sample_.size());
    save();
    outcome.state.adversary = value < start.value ? arrived : start.mesh;
    outcome.state.losses = rows_;
    outcome.steps = std::ssize(rows_);
    outcome.stages = stages_;
    BlackBoxReport& report = outcome.black_box.emplace();
    report.vehicles = sample_.size();
    report.queries = queries(std::ssize(rows_)) + std::ssize(sample_);
    report.numbers = modes.size();
    report.samples = plan_.samples;
    report.generations = meshes / plan_.samples;
    for (const NamedStart& each : starts_) report.starts.push_back({each.name, each.value});
    report.start = start.name;
    report.loss = std::min(value, start.value);
    return outcome;
  }

 private:
  MeshModes modes_of(const TexturedMesh& mesh) const {
    return {mesh, settings_.limits, settings_.parts,
            sees_colours(settings_, run_.detectors.front()->capabilities())};
  }
  AttackStepper stepper_of(const TexturedMesh& mesh) const {
    return {settings_, run_.detectors, run_.store, sample_, mesh.mesh, run_.clean_cache};
  }
  /// Queries that the first `meshes` meshes took.
  long queries(long meshes) const {
    const long starts = std::min(meshes, std::ssize(starts_));
    return starts * std::ssize(sample_) + (meshes - starts) * settings_.batch;
  }

  void open() {
    if (exists(file_)) {
      constexpr const char* kAgain = "delete the file to start the run again";
      const nlohmann::json stored = read_json(file_);
      const JsonFields json(file_, stored, kAgain);
      json.object("identity");
      check_identity(file_, stored.at("identity"), identity_);
      rows_ = read_losses(json, as_size(json.count("iteration", kMaxIterations)));
      if (stored.value("program", nlohmann::json()) != program_identity())
        spdlog::warn("{}: {} meshes were looked at by another program or on another processor",
                     file_.string(), rows_.size());
    }
    require_one_file(file_, std::ssize(rows_), "files");
    if (rank() == 0) write_json(settings_.out / "run.json", identity_.json);
  }

  void save() const {
    if (rank() > 0) return;
    nlohmann::json json = losses_json(rows_);
    json["identity"] = identity_.json;
    json["program"] = program_identity();
    json["iteration"] = rows_.size();
    write_json(file_, json);
    write_losses(settings_.out / "loss.csv", rows_);
  }

  void evaluate(const AttackStepper& stepper, const TexturedMesh& mesh, const std::vector<Host>& hosts,
                std::uint64_t first_world, const std::string& what) {
    if (any_rank(interrupted())) {
      save();
      throw Interrupted(fmt::format("interrupted after {} of {} queries; run the same command to go on",
                                    queries(std::ssize(rows_)), settings_.queries));
    }
    rows_.push_back(stepper.judge(mesh, hosts, first_world, &stages_));
    const LossRow& row = rows_.back();
    progress_.update(
        as_size(queries(std::ssize(rows_))),
        fmt::format("{}  loss {:.3f}  hidden {} of {} found", what, row.loss(), row.hidden, row.found));
    if (timer_.due(std::ssize(rows_))) save();
  }

  /// Judges the starts; returns the best.
  NamedStart& judge_starts() {
    for (std::size_t i = 0; i < starts_.size(); ++i) {
      NamedStart& start = starts_[i];
      if (i == rows_.size())
        evaluate(stepper_of(start.mesh), start.mesh, sample_, kSampleWorlds, "start " + start.name);
      start.value = rows_[i].loss();
      spdlog::info("start {}: {:.4f} on {} vehicles", start.name, start.value, sample_.size());
    }
    return *std::ranges::min_element(starts_, {}, &NamedStart::value);
  }

  const SearchRun& run_;
  const AttackSettings& settings_;
  std::filesystem::path file_;
  std::vector<Host> sample_;
  std::vector<NamedStart> starts_;
  RunIdentity identity_;
  CheckpointTimer timer_;
  Progress progress_;
  BlackBoxPlan plan_;
  std::vector<LossRow> rows_;  // of the judged meshes: first the starts
  StepTimings stages_;
};

}  // namespace

MeshModes::MeshModes(const TexturedMesh& start, const AdversaryLimits& limits, AttackParts parts,
                     bool texture)
    : start_(start),
      limits_(limits),
      sizes_(parts != AttackParts::texture),
      warps_(parts == AttackParts::both || parts == AttackParts::shape),
      paints_(texture && (parts == AttackParts::both || parts == AttackParts::texture)) {
  const auto count = [](Axis axis) { return modes(Vec3d::Zero(), axis).size(); };
  size_ = (sizes_ ? 3 : 0) + (warps_ ? count(Axis::x) + count(Axis::y) + count(Axis::z) : 0) +
          (paints_ ? 3 * count(Axis::colour) : 0);
  const auto& vertices = start.mesh.vertices;
  const auto place = [&](const Vec3d& v) { return v.cwiseQuotient(limits.half).eval(); };
  for (const Vec3d& v : vertices)
    warp_.push_back({modes(place(v), Axis::x), modes(place(v), Axis::y), modes(place(v), Axis::z)});
  paint_.resize(start.atlas.texels.size());
  const auto triangles = atlas_triangles(start.atlas.resolution);
  for (std::size_t f = 0; f < start.mesh.faces.size(); ++f)
    for (const AtlasTriangle& triangle : triangles) {
      const Vec2d b = (triangle.corners[0] + triangle.corners[1] + triangle.corners[2]) / 3;
      const auto corners = start.mesh.corners(start.mesh.faces[f]);
      const Vec3d centre = b[0] * corners[0] + b[1] * corners[1] + (1 - b[0] - b[1]) * corners[2];
      paint_[f * start.atlas.per_face() + as_size(triangle.texel)] = modes(place(centre), Axis::colour);
    }
}

TexturedMesh MeshModes::mesh(std::span<const double> numbers) const {
  TexturedMesh made = start_;
  auto at = numbers.begin();
  const auto sum = [](std::span<const double>::iterator from, const std::vector<double>& values) {
    return std::inner_product(values.begin(), values.end(), from, 0.0);
  };
  if (sizes_) {
    const Vec3d scale(std::exp(kSize * at[0]), std::exp(kSize * at[1]), std::exp(kSize * at[2]));
    for (Vec3d& v : made.mesh.vertices) v = v.cwiseProduct(scale);
    at += 3;
  }
  if (warps_)
    for (int c = 0; c < 3; ++c) {
      const auto axis = as_size(c);
      for (std::size_t i = 0; i < warp_.size(); ++i)
        made.mesh.vertices[i][c] += kWarp * limits_.half[c] * sum(at, warp_[i][axis]);
      at += std::ssize(warp_.front()[axis]);
    }
  if (paints_)
    for (int c = 0; c < 3; ++c) {
      for (std::size_t i = 0; i < paint_.size(); ++i) {
        double& colour = made.atlas.texels[i][c];
        const double start = std::clamp(colour, kMinColour, 1 - kMinColour);
        colour = 1 / (1 + std::exp(-kColour * sum(at, paint_[i])) * (1 - start) / start);
      }
      at += std::ssize(paint_.front());
    }
  project(made, limits_);
  return made;
}

BlackBoxPlan black_box_plan(const AttackSettings& settings, std::size_t starts, std::size_t numbers,
                            std::size_t vehicles) {
  BlackBoxPlan plan;
  plan.samples = 4 + static_cast<int>(3 * std::log(static_cast<double>(numbers)));  // Hansen's default
  plan.samples = std::max(plan.samples, 5);
  const long generation = static_cast<long>(plan.samples) * settings.batch;
  const long beside = static_cast<long>((starts + 1) * vehicles);  // the starts and the final mean
  plan.generations = (settings.queries - beside) / generation;
  if (settings.queries < beside + generation)
    throw FieldError("queries", std::to_string(settings.queries),
                     fmt::format("starts and end take {}, a generation {}", beside, generation),
                     fmt::format("use {} or more, or a smaller --batch", beside + generation));
  return plan;
}

SearchOutcome run_black_box(const SearchRun& run) {
  return BlackBox(run).run();
}

}  // namespace mirage
