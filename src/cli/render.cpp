// mirage render: the meshes of a scene file in each of its cameras, by the soft rasteriser or the ray-traced
// camera.
#include <fmt/format.h>

#include <charconv>

#include "base/error.h"
#include "base/fields.h"
#include "base/image.h"
#include "base/schedule.h"
#include "cli/command.h"
#include "cli/field_options.h"
#include "exchange/gltf.h"
#include "sensors/raster/limits.h"

namespace mirage::cli {
namespace {

struct RenderOptions {
  std::filesystem::path scene;
  std::string renderer = "soft", size, background, parts, window, camera;
  double sigma = SoftRasterSettings<double>().sigma, gamma = 0;
  std::vector<double> color = {0, 0, 0};
  int samples = 2;
  const CLI::App* app = nullptr;  ///< knows which options were given
};

/// InputError for an option of the rasteriser that is given to the ray-traced camera.
void check_renderer(const RenderOptions& options) {
  if (options.renderer == "soft") return;
  for (const char* option : {"--sigma", "--gamma"})
    if (options.app->count(option) > 0)
      throw InputError(option, options.app->get_option(option)->results().back(),
                       "means nothing at --renderer traced, which has no soft edges",
                       "leave it out, or choose --renderer soft");
}

/// Removes pictures of other cameras that an earlier render drew into this folder.
void remove_earlier_cameras(const std::filesystem::path& folder) {
  for (const std::string& name : listed_names(earlier_result(folder), "cameras"))
    for (const std::string& file :
         {"image-" + name + ".exr", "image-" + name + ".png", "depth-" + name + ".exr"})
      std::filesystem::remove(folder / file);
}

/// "1242x375" or "0,0,64,32" as whole numbers.
std::vector<int> whole_numbers(const std::string& option, const std::string& text, char separator,
                               std::size_t count, const std::string& fix) {
  std::vector<int> numbers;
  const char *at = text.data(), *end = text.data() + text.size();
  while (at < end && numbers.size() < count) {
    int value = 0;
    const auto [next, error] = std::from_chars(at, end, value);
    if (error != std::errc() || (next < end && *next != separator)) break;
    numbers.push_back(value);
    at = next < end ? next + 1 : next;
  }
  if (at != end || numbers.size() != count || text.back() == separator)
    throw InputError(option, text, "is not understood", fix);
  return numbers;
}

/// The background behind the objects.
ImageF background_of(const SceneCamera& scene, const RenderOptions& options, bool photograph) {
  if (photograph) {
    if (scene.photograph.empty())
      throw InputError(options.scene.string(), "photograph", "the scene has none", "give --background plain");
    if (scene.photograph.width != scene.camera.width || scene.photograph.height != scene.camera.height)
      throw InputError("--size", options.size,
                       fmt::format("the photograph behind the scene is {}×{}", scene.photograph.width,
                                   scene.photograph.height),
                       "leave --size away or give --background plain");
    return scene.photograph;
  }
  ImageF plain(scene.camera.width, scene.camera.height, 3);
  for (std::size_t i = 0; i < plain.data.size(); ++i)
    plain.data[i] = static_cast<float>(options.color[i % 3]);
  return plain;
}

/// Makes the camera of that name the scene's only one.
void choose_camera(RenderScene& scene, const std::string& name) {
  std::vector<std::string> names = {scene.name};
  for (SceneCamera& other : scene.others) {
    names.push_back(other.name);
    if (other.name == name) std::swap(static_cast<SceneCamera&>(scene), other);
  }
  if (scene.name != name) throw unknown_word("from", name, names);
  scene.others.clear();
}

/// Draws the scene and writes picture and depth, with this suffix in their names.
SceneImage draw(const RenderScene& scene, const ImageF& background, const SceneRenderSettings& settings,
                const std::filesystem::path& folder, const std::string& suffix = "") {
  SceneImage image = render_scene(scene, background, settings);
  ImageF color(image.rgba.width, image.rgba.height, 3);
  for (std::size_t i = 0; i < image.depth.data.size(); ++i)
    std::copy_n(image.rgba.data.data() + 4 * i, 3, color.data.data() + 3 * i);
  write_exr(folder / ("image" + suffix + ".exr"), image.rgba);
  write_srgb(folder / ("image" + suffix + ".png"), color);
  write_exr(folder / ("depth" + suffix + ".exr"), image.depth);
  return image;
}

nlohmann::json run(const RenderOptions& options, const Common& common) {
  const auto started = Clock::now();
  check_renderer(options);
  int width = 0, height = 0;
  if (!options.size.empty()) {
    const auto size = whole_numbers("--size", options.size, 'x', 2, "give WIDTHxHEIGHT, e.g. 1242x375");
    width = size[0];
    height = size[1];
    if (width < 1 || height < 1 ||
        static_cast<std::uint64_t>(width) * static_cast<std::uint64_t>(height) > kMaxPixels)
      throw InputError("--size", options.size, "is not an image size",
                       fmt::format("give at most {} pixels in all", kMaxPixels));
  }
  RenderScene scene = read_scene(options.scene, width, height);
  if (!options.camera.empty()) choose_camera(scene, options.camera);
  if (width > 0 || !options.window.empty()) scene.others.clear();  // pixels of one camera
  if (width > 0) scene.camera = resized(scene.camera, width, height);
  const bool photograph = options.background.empty() ? !scene.photograph.empty() && width == 0
                                                     : options.background == "photograph";
  const ImageF background = background_of(scene, options, photograph);
  // Host and ground stand in for what the photograph already shows.
  const std::string parts = options.parts.empty() ? (photograph ? "adversary" : "all") : options.parts;
  if (parts == "adversary")
    std::erase_if(scene.things,
                  [](const auto& thing) { return thing.role == "host" || thing.role == "ground"; });
  SceneRenderSettings settings;
  settings.renderer = options.renderer == "soft" ? SceneRenderer::soft : SceneRenderer::traced;
  settings.raster.sigma = options.sigma;
  if (options.gamma != 0) settings.gamma = options.gamma;
  settings.samples = options.samples;
  settings.seed = common.seed;
  if (!options.window.empty()) {
    const auto edges = whole_numbers("--window", options.window, ',', 4, "give u0,v0,u1,v1 in pixels");
    settings.rect = {edges[0], edges[1], edges[2], edges[3]};
    if (settings.rect.empty())
      throw InputError("--window", options.window, "holds no pixels",
                       "give u0,v0,u1,v1 with u0 < u1 and v0 < v1");
  }
  remove_earlier_cameras(common.out);
  const auto drawing = Clock::now();
  const SceneImage image = draw(scene, background, settings, common.out);
  nlohmann::json covered = {{scene.name, image.covered}};
  std::string counts = std::to_string(image.covered);
  RenderScene seen = scene;
  for (const SceneCamera& other : scene.others) {
    static_cast<SceneCamera&>(seen) = other;
    const bool recorded = photograph && !other.photograph.empty();
    const int pixels =
        draw(seen, background_of(other, options, recorded), settings, common.out, "-" + other.name).covered;
    covered[other.name] = pixels;
    counts += fmt::format(", {} {}", other.name, pixels);
  }
  const double seconds = seconds_since(drawing);
  print_table({{"meshes", fmt::format("{} with {} faces", scene.things.size(), image.faces)},
               {"pixels covered", counts},
               {"seconds", fmt::format("{:.3f}", seconds)},
               {"picture", (common.out / "image.png").string()}});
  nlohmann::json result = {{"renderer", options.renderer},
                           {"width", scene.camera.width},
                           {"height", scene.camera.height},
                           {"window", {image.rect.u0, image.rect.v0, image.rect.u1, image.rect.v1}},
                           {"meshes", scene.things.size()},
                           {"faces", image.faces},
                           {"pixels_covered", image.covered},
                           {"samples", options.samples},
                           {"background", photograph ? "photograph" : "plain"},
                           {"parts", parts},
                           {"seconds", seconds},
                           {"seconds_total", seconds_since(started)}};
  if (!scene.others.empty()) result["cameras"] = covered;
  if (settings.renderer == SceneRenderer::soft)
    result.update(
        {{"sigma", options.sigma}, {"gamma", image.gamma}, {"near", image.near}, {"far", image.far}});
  return result;
}

void add_options(CLI::App& app, RenderOptions& options) {
  options.app = &app;
  app.add_option("--scene", options.scene, "scene as mirage export writes it (.glb)")->required();
  add_defaulted(app, "--renderer", options.renderer, "soft: soft rasteriser; traced: ray-traced camera")
      ->check(one_of({"soft", "traced"}));
  add_defaulted(app, "--sigma", options.sigma, kSigmaHelp)->check(within({kHardSigma, kMaxSigma}));
  app.add_option("--gamma", options.gamma, std::string(kGammaHelp) + " (default: 3 cm of it)")
      ->check(within({kMinSigma, kMaxGamma}));
  add_defaulted(app, "--samples", options.samples, "samples per pixel along each side")
      ->check(within({1, 32}));
  app.add_option(
      "--from", options.camera,
      "draw the camera of that name only (default: the first as image.png, others as image-NAME.png)");
  app.add_option("--size", options.size, "WIDTHxHEIGHT (default: the scene's)");
  app.add_option("--window", options.window, "draw pixels u0,v0,u1,v1 of one camera only");
  app.add_option("--background", options.background,
                 "photograph or plain (default: the photograph if there is one)")
      ->check(one_of({"photograph", "plain"}));
  add_defaulted(app, "--color", options.color, "plain background, scene-linear R,G,B")
      ->delimiter(',')
      ->expected(3)
      ->check(within(kShare));
  app.add_option("--parts", options.parts,
                 "all, or adversary: without the stand-ins for host and ground (default over a photograph)")
      ->check(one_of({"all", "adversary"}));
}

}  // namespace

Command render_command() {
  return command_of<RenderOptions>({
      .name = "render",
      .help = "draws the meshes of a scene (.glb): picture and depth",
      .example = "mirage render --scene out/export/000008_0.glb --samples 4",
  });
}

}  // namespace mirage::cli
