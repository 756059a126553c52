#include <cmath>
#include <mutex>

#include "arrays.h"
#include "base/error.h"
#include "base/fields.h"
#include "base/sizes.h"
#include "bind.h"
#include "sensors/projection.h"
#include "sensors/raster_batch.h"
#include "validation/thread_clock.h"

namespace mirage::python {
namespace {

constexpr double kMinVertexDepth = 0.1;  // m; faces are clipped at this depth, as in an insertion

/// A mesh in one picture: in a camera's frame, or on screen already.
struct Subject {
  bool is_projected = false;
  std::vector<Vec3d> vertices;  ///< in the camera's frame, or on screen before `scale`
  std::vector<Face> faces;
  std::size_t colors = 0;  ///< rows of three as given
  PinholeCamera camera;
  ProjectedMesh projected;      ///< screen alone is filled where no camera is
  Vec3d scale = Vec3d::Ones();  ///< of the screen's corners

  RasterTarget<float> target;
  Image<double> rgba;  ///< where drawn in double
};

/// Pictures by the soft rasteriser, with the data for their VJP.
struct Raster {
  std::vector<Subject> subjects;
  std::vector<RasterTape> tapes;
  SoftRasterSettings<double> settings;
  int height = 0, width = 0;
  bool in_double = false;
  std::array<float, 3> color{};  ///< of the background, where it is no picture
  py::array_t<float, py::array::c_style | py::array::forcecast> background;  ///< or empty
  py::array image;  ///< made with a background that its owner may change; otherwise on demand

  std::vector<RasterJob> jobs() const {
    std::vector<RasterJob> jobs;
    for (const Subject& s : subjects) jobs.push_back({&s.projected.screen, &settings, &s.target});
    return jobs;
  }
  const float* photograph() const { return background.size() ? background.data() : nullptr; }
};
using SharedRaster = std::shared_ptr<Raster>;

/// Tapes of pictures that are gone: their memory is worth keeping.
class TapePool {
 public:
  std::vector<RasterTape> take(std::size_t count) {
    const std::lock_guard lock(mutex_);
    std::vector<RasterTape> tapes;
    for (; tapes.size() < count && !free_.empty(); free_.pop_back()) tapes.push_back(std::move(free_.back()));
    tapes.resize(count);
    return tapes;
  }
  void give_back(std::vector<RasterTape> tapes) {
    constexpr std::size_t kMax = 8;
    const std::lock_guard lock(mutex_);
    for (RasterTape& tape : tapes)
      if (free_.size() < kMax) free_.push_back(std::move(tape));
  }

 private:
  std::mutex mutex_;
  std::vector<RasterTape> free_;
};

TapePool& tape_pool() {
  static TapePool pool;
  return pool;
}

/// The settings by name; others keep their defaults.
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
    for (const auto& [choice, value] : choices)
      if (word->second == choice) return void(field = value);
    std::vector<std::string> all;
    for (const auto& [choice, value] : choices) all.push_back(choice);
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
    throw InputError("rasterize", "near, far", "is not a depth range", "use 0 < near < far, in m");
  if (!(settings.sigma > 0) || !(settings.gamma > 0))
    throw InputError("rasterize", "sigma, gamma", "must be positive", "use e.g. 1e-5 and 1e-2");
  return settings;
}

void choose_background(Raster& raster, const py::object& background) {
  if (background.is_none()) return;
  const py::array any = any_array(background, "background");
  raster.background = any;
  if (raster.background.size() == 3) {
    std::copy_n(raster.background.data(), 3, raster.color.begin());
    raster.background = {};
  } else {
    check_shape(any, "background", {raster.height, raster.width, 3});
  }
}

/// Pixels [from, to) of the background without any drawing; channels after RGB are 0.
template <class T>
void fill_background(const Raster& raster, std::size_t from, std::size_t to, int channels, T* out) {
  const float* photograph = raster.photograph();
  for (std::size_t i = from; i < to; ++i) {
    for (std::size_t c = 0; c < 3; ++c)
      *out++ = static_cast<T>(photograph ? photograph[3 * i + c] : raster.color[c]);
    for (int c = 3; c < channels; ++c) *out++ = 0;
  }
}

void draw_subject(const Raster& raster, Subject& subject, int supersampling) {
  RasterTarget<float>& target = subject.target;
  target.width = raster.width;
  target.height = raster.height;
  target.supersampling = supersampling;
  target.rect = touched_pixels(subject.projected.screen, raster.settings, raster.width, raster.height,
                               {0, 0, raster.width, raster.height});
  const PixelRect& rect = target.rect;
  if (rect.empty()) target.rect = {};
  target.background = ImageF(rect.width(), rect.height(), 3);
  for (int v = rect.v0; v < rect.v1; ++v) {
    const std::size_t row = as_size(v) * as_size(raster.width);
    fill_background(raster, row + as_size(rect.u0), row + as_size(rect.u1), 3,
                    target.background.pixel(0, v - rect.v0));
  }
  if (raster.in_double)
    subject.rgba = rasterize(subject.projected.screen, raster.settings, to_double(target));
}

void draw(Raster& raster, int supersampling) {
  for (Subject& subject : raster.subjects) draw_subject(raster, subject, supersampling);
  if (!raster.in_double) rasterize_batch(raster.jobs(), raster.tapes);
}

/// Channels [first, first + count) of a subject's RGBA over its picture, count numbers a pixel.
template <class T>
void put(const Raster& raster, std::size_t n, int first, int count, T* out) {
  const PixelRect& rect = raster.subjects[n].target.rect;
  for (int v = 0; v < rect.height(); ++v) {
    T* to = out + static_cast<std::ptrdiff_t>(count) *
                      (static_cast<std::ptrdiff_t>(rect.v0 + v) * raster.width + rect.u0);
    for (int u = 0; u < rect.width(); ++u)
      for (int c = 0; c < count; ++c)
        *to++ = static_cast<T>(raster.in_double ? raster.subjects[n].rgba.at(u, v, first + c)
                                                : double(raster.tapes[n].rgba.at(u, v, first + c)));
  }
}

/// A subject's whole picture: RGB, or RGBA.
template <class T>
void compose(const Raster& raster, std::size_t n, int channels, T* out) {
  const auto width = as_size(raster.width), row = as_size(channels) * width;
  for (std::size_t v = 0; v < as_size(raster.height); ++v)
    if (raster.photograph() || v == 0)
      fill_background(raster, v * width, (v + 1) * width, channels, out + v * row);
    else
      std::copy_n(out, row, out + v * row);
  put(raster, n, 0, channels, out);
}

/// The window's upstream gradients, `count` channels from `first` on. False for a number that is not finite.
template <class T, class To>
bool take_window(const Strided<T>& from, const PixelRect& rect, int first, int count, Image<To>& d_rgba) {
  return take(from, rect, count,
              [&](int u, int v) { return d_rgba.pixel(u - rect.u0, v - rect.v0) + first; });
}

struct Gradient {
  std::vector<Vec3d> vertices, colors;
};

/// The screen's gradient → the subject's vertices and colours.
Gradient gather(const Subject& subject, const ScreenGradient<double>& screen) {
  Gradient gradient{std::vector<Vec3d>(subject.vertices.size(), Vec3d::Zero()),
                    std::vector<Vec3d>(subject.colors, Vec3d::Zero())};
  if (subject.is_projected) {
    project_mesh_vjp(subject.projected, subject.vertices, subject.camera, kMinVertexDepth, screen,
                     gradient.vertices, gradient.colors);
    return gradient;
  }
  const bool by_vertex = subject.projected.screen.texture == Texture::vertex;
  for (std::size_t f = 0; f < subject.faces.size(); ++f)
    for (std::size_t k = 0; k < 3; ++k) {
      const auto vertex = as_size(subject.faces[f][k]);
      gradient.vertices[vertex] += screen.faces[f][k].cwiseProduct(subject.scale);
      if (by_vertex) gradient.colors[vertex] += screen.texels[3 * f + k];
    }
  if (!by_vertex) gradient.colors = screen.texels;
  return gradient;
}

/// upstream[n] as read_upstream() fills it, in the precision of the drawing.
std::vector<Gradient> backward(Raster& raster, const std::vector<ImageF>& upstream,
                               const std::vector<Image<double>>& upstream_in_double) {
  std::vector<ScreenGradient<double>> screens(raster.subjects.size());
  if (raster.in_double)
    for (std::size_t n = 0; n < screens.size(); ++n) {
      const Subject& subject = raster.subjects[n];
      screens[n] = rasterize_vjp(subject.projected.screen, raster.settings, to_double(subject.target),
                                 upstream_in_double[n]);
    }
  else
    rasterize_batch_vjp(raster.jobs(), upstream, raster.tapes, screens);
  std::vector<Gradient> gradients;
  for (std::size_t n = 0; n < screens.size(); ++n)
    gradients.push_back(gather(raster.subjects[n], screens[n]));
  return gradients;
}

Shape shape_of(const Raster& raster, int channels) {
  Shape shape = {ssize(raster.subjects.size()), raster.height, raster.width};
  if (channels > 1) shape.push_back(channels);
  return shape;
}

template <class T>
py::array pictures(const Raster& raster, int channels) {
  const py::array_t<T> array(shape_of(raster, channels));
  T* out = const_cast<T*>(array.data());
  const py::gil_scoped_release free;
  const std::ptrdiff_t size = std::ptrdiff_t{channels} * raster.height * raster.width;
  for (std::size_t n = 0; n < raster.subjects.size(); ++n, out += size) compose(raster, n, channels, out);
  return array;
}

py::array drawn_image(Raster& raster, int channels) {
  if (channels == 3 && raster.image.size()) return raster.image;
  return raster.in_double ? pictures<double>(raster, channels) : pictures<float>(raster, channels);
}

template <class T>
py::array masks(const Raster& raster) {
  // Pages that nothing is drawn on are never touched.
  const auto array = py::module_::import("numpy")
                         .attr("zeros")(shape_of(raster, 1), py::dtype::of<T>())
                         .template cast<py::array_t<T>>();
  T* out = const_cast<T*>(array.data());
  for (std::size_t n = 0; n < raster.subjects.size();
       ++n, out += std::ptrdiff_t{raster.height} * raster.width)
    put(raster, n, 3, 1, out);
  return array;
}

/// The window's part of an upstream gradient, channels [first, first + count) of RGBA, as it lies in memory.
template <class Picture>
void read_upstream(const Raster& raster, const py::array& array, const char* name, int first, int count,
                   std::vector<Picture>& d_rgba) {
  bool finite = true;
  read_in_place(array, name, shape_of(raster, count), [&](const auto& from) {
    for (std::size_t n = 0; n < d_rgba.size(); ++n)
      finite &= take_window(from.part(n), raster.subjects[n].target.rect, first, count, d_rgba[n]);
  });
  if (!finite) throw Failure(name, "is not finite", "check the loss that it comes from");
}

/// d_image: of RGB, or of RGBA where no d_mask is given.
template <class Picture>
std::vector<Picture> upstream_of(const Raster& raster, const py::object& d_image, const py::object& d_mask) {
  std::vector<Picture> d_rgba;
  for (const Subject& subject : raster.subjects)
    d_rgba.emplace_back(subject.target.rect.width(), subject.target.rect.height(), 4);
  if (!d_image.is_none()) {
    const py::array array = any_array(d_image, "d_image");
    const bool both = d_mask.is_none() && array.ndim() == 4 && array.shape(3) == 4;
    read_upstream(raster, array, "d_image", 0, both ? 4 : 3, d_rgba);
  }
  if (!d_mask.is_none()) read_upstream(raster, any_array(d_mask, "d_mask"), "d_mask", 3, 1, d_rgba);
  return d_rgba;
}

py::list raster_vjp(Raster& raster, const py::object& d_image, const py::object& d_mask) {
  std::vector<ImageF> upstream;
  std::vector<Image<double>> in_double;
  if (raster.in_double)
    in_double = upstream_of<Image<double>>(raster, d_image, d_mask);
  else
    upstream = upstream_of<ImageF>(raster, d_image, d_mask);
  std::vector<Gradient> gradients;
  {
    const py::gil_scoped_release free;
    gradients = backward(raster, upstream, in_double);
  }
  py::list list;
  for (Gradient& gradient : gradients)
    list.append(py::make_tuple(own_rows(std::move(gradient.vertices)), own_rows(std::move(gradient.colors))));
  return list;
}

/// A raster without its subjects.
SharedRaster raster_of(int height, int width, const py::object& background,
                       const std::map<std::string, double>& numbers,
                       const std::map<std::string, std::string>& words, int supersampling, bool in_double,
                       std::size_t count) {
  if (height < 1 || width < 1 || height > 32768 || width > 32768)
    throw InputError("rasterize", "size", std::to_string(height) + " × " + std::to_string(width),
                     "give 1 to 32768 pixels a side");
  if (supersampling < 1 || supersampling > 32)
    throw InputError("rasterize", "supersampling", std::to_string(supersampling), "use 1 to 32");
  SharedRaster raster(new Raster, [](Raster* r) {
    tape_pool().give_back(std::move(r->tapes));
    delete r;
  });
  raster->settings = settings_of(numbers, words);
  raster->in_double = in_double;
  raster->height = height;
  raster->width = width;
  choose_background(*raster, background);
  raster->subjects.resize(count);
  raster->tapes = tape_pool().take(in_double ? 0 : count);
  return raster;
}

void finish(Raster& raster, int supersampling) {
  {
    const py::gil_scoped_release free;
    draw(raster, supersampling);
  }
  if (!raster.photograph()) return;
  raster.image = drawn_image(raster, 3);
}

void project(Subject& subject, const TexturedMesh& mesh, const std::array<double, 4>& intrinsics, int height,
             int width) {
  subject.is_projected = true;
  subject.camera = {intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3], width, height};
  subject.vertices = mesh.mesh.vertices;
  subject.colors = mesh.atlas.texels.size();
  subject.projected = project_mesh(subject.vertices, mesh.mesh.faces, subject.camera, kMinVertexDepth,
                                   Texture::atlas, mesh.atlas.resolution, mesh.atlas.texels);
}

/// meshes[n] by intrinsics[n].
SharedRaster rasterize_meshes(const std::vector<std::shared_ptr<TexturedMesh>>& meshes,
                              const std::vector<std::array<double, 4>>& intrinsics, int height, int width,
                              const py::object& background, const std::map<std::string, double>& numbers,
                              const std::map<std::string, std::string>& words, int supersampling,
                              bool in_double) {
  for (const auto& mesh : meshes) {
    check_mesh(*mesh, "mesh");
    if (mesh->mesh.faces.empty())
      throw InputError("mesh", "faces", "there are none", "give a mesh with faces");
  }
  SharedRaster raster =
      raster_of(height, width, background, numbers, words, supersampling, in_double, meshes.size());
  for (std::size_t n = 0; n < meshes.size(); ++n)
    project(raster->subjects[n], *meshes[n], intrinsics[n], height, width);
  finish(*raster, supersampling);
  return raster;
}

/// On screen already: vertices (V×3), faces (F×3), colours of vertices (V×3) or of C×C texels a face.
void read_screen(Subject& subject, const py::handle& vertices, const py::handle& faces,
                 const py::handle& colors, bool by_vertex, const Vec3d& scale) {
  subject.scale = scale;
  subject.vertices = rows_of_three(vertices, "vertices");
  const std::vector<Vec3d> triples = rows_of_three(colors, "colors");
  subject.colors = triples.size();
  subject.faces = faces_of(faces);
  const std::size_t count = subject.faces.size();
  for (const Face& face : subject.faces)
    for (const int corner : face)
      if (corner < 0 || as_size(corner) >= subject.vertices.size())
        throw InputError("faces", "", std::to_string(corner) + " is not a vertex",
                         "give 0 to " + std::to_string(subject.vertices.size()) + " − 1");
  ScreenMesh<double>& screen = subject.projected.screen;
  screen.texture = by_vertex ? Texture::vertex : Texture::atlas;
  if (!by_vertex && count > 0)
    while (count * as_size(screen.resolution) * as_size(screen.resolution) < triples.size())
      ++screen.resolution;
  const std::size_t expected =
      by_vertex ? subject.vertices.size() : count * as_size(screen.resolution) * as_size(screen.resolution);
  if (triples.size() != expected)
    throw InputError("colors", "shape",
                     std::to_string(triples.size()) + " colours for " +
                         (by_vertex ? std::to_string(subject.vertices.size()) + " vertices"
                                    : std::to_string(count) + " faces"),
                     by_vertex ? "give vertices × 3 numbers" : "give faces × C × C × 3 numbers");
  screen.faces.resize(count);
  for (std::size_t f = 0; f < count; ++f)
    for (std::size_t k = 0; k < 3; ++k)
      screen.faces[f][k] = subject.vertices[as_size(subject.faces[f][k])].cwiseProduct(scale);
  if (!by_vertex) {
    screen.texels = triples;
    return;
  }
  for (const Face& face : subject.faces)
    for (const int corner : face) screen.texels.push_back(triples[as_size(corner)]);
}

SharedRaster rasterize_screens(const std::vector<py::object>& vertices, const std::vector<py::object>& faces,
                               const std::vector<py::object>& colors, bool by_vertex,
                               const std::array<double, 3>& scale, int height, int width,
                               const py::object& background, const std::map<std::string, double>& numbers,
                               const std::map<std::string, std::string>& words, int supersampling,
                               bool in_double) {
  SharedRaster raster =
      raster_of(height, width, background, numbers, words, supersampling, in_double, vertices.size());
  for (std::size_t n = 0; n < vertices.size(); ++n)
    read_screen(raster->subjects[n], vertices[n], faces[n], colors[n], by_vertex,
                {scale[0], scale[1], scale[2]});
  finish(*raster, supersampling);
  return raster;
}

/// CPU time (ms) of a picture of `channels` with its VJP through C++ alone: [kernel, with the filling of the
/// picture and the reading of a gradient as large], the baseline of the module's overhead.
std::array<double, 2> time_rasterization(const TexturedMesh& mesh, const std::array<double, 4>& intrinsics,
                                         int height, int width, const py::object& background,
                                         const std::map<std::string, double>& numbers,
                                         const std::map<std::string, std::string>& words, int channels) {
  const auto size = as_size(channels) * as_size(height * width);
  const std::vector<float> d_image(size, 1);
  std::vector<float> picture(size);
  const std::ptrdiff_t pixel = std::ptrdiff_t{4} * channels;
  const Strided<float> upstream{reinterpret_cast<const char*>(d_image.data()), {pixel * width, pixel, 4}};
  const SharedRaster raster = raster_of(height, width, background, numbers, words, 1, false, 1);
  const py::gil_scoped_release free;
  double kernel = cpu_ms([&] {
    project(raster->subjects[0], mesh, intrinsics, height, width);
    draw(*raster, 1);
  });
  const PixelRect& rect = raster->subjects[0].target.rect;
  std::vector<ImageF> d_rgba(1);
  const double around = cpu_ms([&] {
    compose(*raster, 0, channels, picture.data());
    d_rgba[0] = ImageF(rect.width(), rect.height(), 4);
    take_window(upstream, rect, 0, channels, d_rgba[0]);
  });
  kernel += cpu_ms([&] { backward(*raster, d_rgba, {}); });
  return {kernel, kernel + around};
}

}  // namespace

void bind_rasterizer(py::module_& module) {
  py::class_<Raster, SharedRaster>(module, "Raster", "N pictures drawn by the soft rasteriser.")
      .def_property_readonly(
          "image", [](Raster& r) { return drawn_image(r, 3); },
          "N×H×W×3 float32 (float64 if drawn in double): the mesh over the background, scene-linear RGB.")
      .def_property_readonly(
          "mask", [](const Raster& r) { return r.in_double ? masks<double>(r) : masks<float>(r); },
          "N×H×W float32 (float64 if drawn in double): the silhouette S, 0 … 1.")
      .def_property_readonly(
          "rgba", [](Raster& r) { return drawn_image(r, 4); }, "N×H×W×4: image and mask.")
      .def("vjp", &raster_vjp, py::arg("d_image") = py::none(), py::arg("d_mask") = py::none());
  module.def("rasterize_meshes", &rasterize_meshes);
  module.def("rasterize_screens", &rasterize_screens);
  module.def("time_rasterization", &time_rasterization);
}

}  // namespace mirage::python
