#include "arrays.h"

#include <fmt/format.h>

#include "base/error.h"
#include "base/memory.h"
#include "base/sizes.h"

namespace mirage::python {
namespace {

std::string text_of(const Shape& shape) {
  std::string text;
  for (const py::ssize_t length : shape)
    text += (text.empty() ? "" : " × ") + (length < 0 ? std::string("N") : std::to_string(length));
  return text.empty() ? "a single number" : text;
}

}  // namespace

py::array any_array(const py::handle& values, const std::string& name) {
  if (py::isinstance<py::array>(values)) return py::reinterpret_borrow<py::array>(values);
  try {
    if (py::hasattr(values, "__dlpack__"))
      return py::module_::import("numpy").attr("from_dlpack")(values).cast<py::array>();
    return py::module_::import("numpy").attr("asarray")(values).cast<py::array>();
  } catch (const py::error_already_set& error) {
    if (error.matches(PyExc_ImportError)) throw;
    throw InputError(name, "", std::string("is not an array that can be read (") + error.what() + ")",
                     "give a NumPy array, or a tensor as tensor.detach().cpu()");
  }
}

void check_shape(const py::array& array, const std::string& name, const Shape& shape) {
  Shape actual(array.shape(), array.shape() + array.ndim());
  bool fits = actual.size() == shape.size();
  for (std::size_t i = 0; fits && i < shape.size(); ++i) fits = shape[i] < 0 || shape[i] == actual[i];
  if (!fits) throw InputError(name, "shape", "is " + text_of(actual), "give " + text_of(shape) + " numbers");
  const char kind = array.dtype().kind();
  if (kind != 'f' && kind != 'i' && kind != 'u' && kind != 'b')
    throw InputError(name, "dtype", "holds no real numbers", "give float32 or float64");
}

std::vector<Vec3d> rows_of_three(const py::handle& values, const std::string& name) {
  static_assert(sizeof(Vec3d) == 3 * sizeof(double));
  const py::array any = any_array(values, name);
  const Shape shape(any.shape(), any.shape() + any.ndim());
  check_shape(any, name, shape);
  if (shape.empty() || shape.back() != 3)
    throw InputError(name, "shape", "is " + text_of(shape), "give rows of three numbers");
  std::vector<Vec3d> rows(as_size(any.size() / 3));
  if (rows.empty()) return rows;
  double* const to = rows.front().data();
  using Floats = py::array_t<float, py::array::c_style>;
  if (Floats::check_(any)) {  // as tensors are: no array between
    const auto* from = static_cast<const float*>(any.data());
    std::copy(from, from + any.size(), to);
    return rows;
  }
  const py::array_t<double, py::array::c_style | py::array::forcecast> array(any);
  copy_bytes(to, array.data(), rows.size() * sizeof(Vec3d));
  return rows;
}

std::vector<Face> faces_of(const py::handle& values) {
  const auto array = array_of<int>(values, "faces", {-1, 3});
  std::vector<Face> faces(as_size(array.shape(0)));
  const int* index = array.data();
  for (Face& face : faces)
    for (int& corner : face) corner = *index++;
  return faces;
}

void check_albedo(std::span<const Vec3d> texels) {
  constexpr double kSlack = 1e-3;
  for (const Vec3d& texel : texels)
    for (const double value : texel)
      if (!(value >= -kSlack && value <= 1 + kSlack))
        throw InputError(
            "texels", "", fmt::format("{:g} is not an albedo", value),
            "give scene-linear RGB in [0, 1] (8-bit values / 255 are sRGB, which is not linear)");
}

}  // namespace mirage::python
