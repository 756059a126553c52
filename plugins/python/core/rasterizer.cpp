#include <cmath>

#include "arrays.h"
#include "base/error.h"
#include "base/words.h"
#include "bind.h"
#include "sensors/projection.h"
#include "sensors/raster_batch.h"

namespace mirage::python {
namespace {

constexpr double kNearestVertex = 0.1;  // m; faces are clipped at this depth, as in an insertion

/// A picture by the soft rasteriser and what its VJP needs.
struct Raster {
  ScreenMesh<double> screen;  ///< where no mesh was projected
  ProjectedMesh projected;
  std::vector<Vec3d> p_camera;
  std::size_t texels = 0;
  PinholeCamera camera;
  bool is_projected = false, in_double = false;
  SoftRasterSettings<double> settings;
  RasterTarget<float> target;
  ImageF background;
  RasterTape tape;
  Image<double> rgba;

  const ScreenMesh<double>& drawn() const { return is_projected ? projected.screen : screen; }
};
using Shared = std::shared_ptr<Raster>;

/// Of one name each; what is not named keeps its default.
SoftRasterSettings<double> settings_of(const std::map<std::string, double>& numbers,
                                       const std::map<std::string, std::string>& words) {
  SoftRasterSettings<double> settings;
  const std::map<std::string, double*> fields = {
      {"sigma", &settings.sigma},       {"gamma", &settings.gamma}, {"epsilon", &settings.epsilon},
      {"dist_eps", &settings.dist_eps}, {"near", &settings.near},   {"far", &settings.far}};
  for (const auto& [name, value] : numbers) {
    const auto field = fields.find(name);
    if (field == fields.end())
      throw InputError(
          "rasterize", name, "unknown setting",
          use_one_of(name, {"sigma", "gamma", "epsilon", "dist_eps", "near", "far", "blend", "sides"}));
    *field->second = value;
  }
  const auto choose = [&](const std::string& name, auto& field, const auto& choices) {
    const auto word = words.find(name);
    if (word == words.end()) return;
    for (const auto& [known, value] : choices)
      if (word->second == known) return void(field = value);
    std::vector<std::string> all;
    for (const auto& [known, value] : choices) all.push_back(known);
    throw InputError("rasterize", name, word->second + " is unknown", use_one_of(word->second, all));
  };
  choose("blend", settings.background,
         std::map<std::string, Background>{{"silhouette", Background::silhouette},
                                           {"logit", Background::paper_logit}});
  choose("sides", settings.sides,
         std::map<std::string, Sides>{{"both", Sides::both},
                                      {"counter_clockwise", Sides::counter_clockwise},
                                      {"clockwise", Sides::clockwise}});
  if (!(settings.near > 0) || !(settings.far > settings.near) || !std::isfinite(settings.far))
    throw InputError("rasterize", "near, far", "is no depth range", "use 0 < near < far, in m");
  if (!(settings.sigma > 0) || !(settings.gamma > 0))
    throw InputError("rasterize", "sigma, gamma", "must be positive", "use e.g. 1e-5 and 1e-2");
  return settings;
}

void draw(Raster& raster, int height, int width, const py::object& background, int supersampling) {
  if (height < 1 || width < 1 || height > 32768 || width > 32768)
    throw InputError("rasterize", "size", std::to_string(height) + " × " + std::to_string(width),
                     "give 1 to 32768 pixels a side");
  if (supersampling < 1 || supersampling > 32)
    throw InputError("rasterize", "supersampling", std::to_string(supersampling), "use 1 to 32");
  raster.background = ImageF(width, height, 3);
  if (!background.is_none()) {
    const py::array any = any_array(background, "background");
    const py::array_t<float, py::array::c_style | py::array::forcecast> given(any);
    const std::size_t count = raster.background.data.size();
    if (given.size() != 3 && static_cast<std::size_t>(given.size()) != count)
      throw InputError("background", "shape", std::to_string(given.size()) + " numbers",
                       "give a colour (3) or a picture (height × width × 3)");
    for (std::size_t i = 0; i < count; ++i)
      raster.background.data[i] = given.data()[given.size() == 3 ? i % 3 : i];
  }
  const py::gil_scoped_release free;
  RasterTarget<float>& target = raster.target;
  target.width = width;
  target.height = height;
  target.supersampling = supersampling;
  target.rect = touched_pixels(raster.drawn(), raster.settings, width, height, {0, 0, width, height});
  const PixelRect& rect = target.rect;
  target.background = ImageF(rect.width(), rect.height(), 3);
  for (int v = 0; v < rect.height(); ++v)
    std::copy_n(raster.background.pixel(rect.u0, rect.v0 + v), 3 * rect.width(),
                target.background.pixel(0, v));
  if (rect.empty()) return;
  if (raster.in_double) {
    raster.rgba = rasterize(raster.drawn(), raster.settings, to_double(target));
  } else {
    const RasterJob job{&raster.drawn(), &raster.settings, &target};
    rasterize_batch({&job, 1}, {&raster.tape, 1});
    raster.rgba = to_double(raster.tape.rgba);
  }
}

template <class T>
py::array_t<T> picture(const Raster& raster, int first, int count) {
  const ImageF& background = raster.background;
  std::vector<T> values(static_cast<std::size_t>(background.width) * background.height * count);
  if (first == 0) std::copy(background.data.begin(), background.data.end(), values.begin());
  const PixelRect& rect = raster.target.rect;
  for (int v = 0; v < rect.height(); ++v)
    for (int u = 0; u < rect.width(); ++u)
      for (int c = 0; c < count; ++c)
        values[count * (static_cast<std::size_t>(rect.v0 + v) * background.width + rect.u0 + u) + c] =
            static_cast<T>(raster.rgba.at(u, v, first + c));
  Shape shape = {background.height, background.width};
  if (count > 1) shape.push_back(count);
  return own(std::move(values), shape);
}

py::array any_picture(const Raster& raster, int first, int count) {
  if (raster.in_double) return picture<double>(raster, first, count);
  return picture<float>(raster, first, count);
}

/// The window's part of the upstream gradients.
Image<double> upstream(const Raster& raster, const py::object& d_image, const py::object& d_mask) {
  const PixelRect& rect = raster.target.rect;
  const py::ssize_t height = raster.background.height, width = raster.background.width;
  Image<double> d_rgba(rect.width(), rect.height(), 4);
  const auto take = [&](const py::object& given, const char* name, int first, int count) {
    if (given.is_none()) return;
    const auto array =
        array_of<double>(given, name, count == 1 ? Shape{height, width} : Shape{height, width, count});
    for (int v = 0; v < rect.height(); ++v)
      for (int u = 0; u < rect.width(); ++u)
        for (int c = 0; c < count; ++c) {
          const double value = array.data()[count * ((rect.v0 + v) * width + rect.u0 + u) + c];
          if (!std::isfinite(value))
            throw Failure(name, "is not finite", "check the loss that it comes from");
          d_rgba.at(u, v, first + c) = value;
        }
  };
  take(d_image, "d_image", 0, 3);
  take(d_mask, "d_mask", 3, 1);
  return d_rgba;
}

py::tuple vjp(const Shared& raster, const py::object& d_image, const py::object& d_mask) {
  const Image<double> d_rgba = upstream(*raster, d_image, d_mask);
  ScreenGradient<double> gradient;
  const auto d_vertices = std::make_shared<std::vector<Vec3d>>(raster->p_camera.size(), Vec3d::Zero());
  const auto d_texels = std::make_shared<std::vector<Vec3d>>(raster->texels, Vec3d::Zero());
  const ScreenMesh<double>& drawn = raster->drawn();
  {
    const py::gil_scoped_release free;
    if (raster->target.rect.empty()) {
      gradient.faces.assign(drawn.faces.size(), {Vec3d::Zero(), Vec3d::Zero(), Vec3d::Zero()});
      gradient.texels.assign(drawn.texels.size(), Vec3d::Zero());
    } else if (raster->in_double) {
      gradient = rasterize_vjp(drawn, raster->settings, to_double(raster->target), d_rgba);
    } else {
      const RasterJob job{&drawn, &raster->settings, &raster->target};
      ImageF narrow(d_rgba.width, d_rgba.height, 4);
      std::copy(d_rgba.data.begin(), d_rgba.data.end(), narrow.data.begin());
      rasterize_batch_vjp({&job, 1}, {&narrow, 1}, {&raster->tape, 1}, {&gradient, 1});
    }
    if (raster->is_projected)
      project_mesh_vjp(raster->projected, raster->p_camera, raster->camera, kNearestVertex, gradient,
                       *d_vertices, *d_texels);
  }
  if (raster->is_projected)
    return py::make_tuple(view(d_vertices->front().data(), {ssize(d_vertices->size()), 3}, d_vertices, true),
                          view(d_texels->front().data(), {ssize(d_texels->size()), 3}, d_texels, true));
  const auto kept = std::make_shared<ScreenGradient<double>>(std::move(gradient));
  return py::make_tuple(view(kept->faces.empty() ? nullptr : kept->faces.front().front().data(),
                             {ssize(kept->faces.size()), 3, 3}, kept, true),
                        view(kept->texels.empty() ? nullptr : kept->texels.front().data(),
                             {ssize(kept->texels.size()), 3}, kept, true));
}

Shared rasterize_mesh(const TexturedMesh& mesh, const std::array<double, 4>& intrinsics, int height,
                      int width, const py::object& background, const std::map<std::string, double>& numbers,
                      const std::map<std::string, std::string>& words, int supersampling, bool in_double) {
  check_mesh(mesh, "mesh");
  if (mesh.mesh.faces.empty()) throw InputError("mesh", "faces", "there are none", "give a mesh with faces");
  auto raster = std::make_shared<Raster>();
  raster->settings = settings_of(numbers, words);
  raster->in_double = in_double;
  raster->is_projected = true;
  raster->camera = {intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3], width, height};
  raster->p_camera = mesh.mesh.vertices;
  raster->texels = mesh.atlas.texels.size();
  raster->projected = project_mesh(raster->p_camera, mesh.mesh.faces, raster->camera, kNearestVertex,
                                   Texture::atlas, mesh.atlas.resolution, mesh.atlas.texels);
  draw(*raster, height, width, background, supersampling);
  return raster;
}

Shared rasterize_screen(const py::object& faces, const py::object& texels, bool of_vertices, int height,
                        int width, const py::object& background, const std::map<std::string, double>& numbers,
                        const std::map<std::string, std::string>& words, int supersampling, bool in_double) {
  const auto corners = array_of<double>(faces, "faces", {-1, 3, 3});
  auto raster = std::make_shared<Raster>();
  raster->settings = settings_of(numbers, words);
  raster->in_double = in_double;
  ScreenMesh<double>& screen = raster->screen;
  screen.faces.resize(static_cast<std::size_t>(corners.shape(0)));
  const double* from = corners.data();
  for (auto& face : screen.faces)
    for (Vec3d& corner : face) {
      corner = Vec3d(from[0], from[1], from[2]);
      from += 3;
    }
  screen.texels = rows_of_three(texels, "texels");
  screen.texture = of_vertices ? Texture::vertex : Texture::atlas;
  const std::size_t count = screen.faces.size();
  if (!of_vertices)
    while (count * screen.resolution * screen.resolution < screen.texels.size()) ++screen.resolution;
  const std::size_t per_face =
      of_vertices ? 3 : static_cast<std::size_t>(screen.resolution) * screen.resolution;
  if (screen.texels.size() != count * per_face)
    throw InputError(
        "texels", "shape",
        std::to_string(screen.texels.size()) + " colours for " + std::to_string(count) + " faces",
        of_vertices ? "give faces × 3 × 3 numbers" : "give faces × C × C × 3 numbers");
  raster->texels = screen.texels.size();
  draw(*raster, height, width, background, supersampling);
  return raster;
}

}  // namespace

void bind_rasterizer(py::module_& module) {
  py::class_<Raster, Shared>(module, "Raster", "A picture by the soft rasteriser.")
      .def_property_readonly(
          "image", [](const Raster& r) { return any_picture(r, 0, 3); },
          "H×W×3 float32 (float64 if drawn in double): the mesh over the background, scene-linear RGB.")
      .def_property_readonly(
          "mask", [](const Raster& r) { return any_picture(r, 3, 1); },
          "H×W float32 (float64 if drawn in double): the silhouette S, 0 … 1.")
      .def("_vjp", &vjp, py::arg("d_image") = py::none(), py::arg("d_mask") = py::none());
  module.def("rasterize_mesh", &rasterize_mesh);
  module.def("rasterize_screen", &rasterize_screen);
}

}  // namespace mirage::python
