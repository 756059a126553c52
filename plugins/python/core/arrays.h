// NumPy arrays over Mirage's memory, and Mirage's types out of other people's arrays.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <memory>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "base/image.h"
#include "base/types.h"

namespace mirage::python {

namespace py = pybind11;
using Shape = std::vector<py::ssize_t>;

/// An array over memory that `owner` keeps alive: nothing is copied.
template <class T>
py::array_t<T> view(const T* data, const Shape& shape, std::shared_ptr<const void> owner, bool writable) {
  const auto drop = [](void* kept) { delete static_cast<std::shared_ptr<const void>*>(kept); };
  const py::capsule base(new std::shared_ptr<const void>(std::move(owner)), drop);
  py::array_t<T> array(shape, data, base);
  if (!writable) py::detail::array_proxy(array.ptr())->flags &= ~py::detail::npy_api::NPY_ARRAY_WRITEABLE_;
  return array;
}

/// An array that owns its values.
template <class T>
py::array_t<T> own(std::vector<T> values, const Shape& shape) {
  const auto kept = std::make_shared<std::vector<T>>(std::move(values));
  return view(kept->data(), shape, kept, true);
}

inline py::ssize_t ssize(std::size_t size) {
  return static_cast<py::ssize_t>(size);
}

/// A view of rows of three, N × 3.
template <class Row>
auto view_rows(const std::vector<Row>& rows, std::shared_ptr<const void> owner, bool writable) {
  return view(rows.empty() ? nullptr : rows.front().data(), {ssize(rows.size()), 3}, std::move(owner),
              writable);
}

/// Rows that the array owns.
inline py::array_t<double> own_rows(std::vector<Vec3d> rows) {
  const auto kept = std::make_shared<std::vector<Vec3d>>(std::move(rows));
  return view_rows(*kept, kept, true);
}

/// A CPU array out of a NumPy array, anything with __dlpack__ or nested lists. InputError naming `name`.
py::array any_array(const py::handle& values, const std::string& name);

/// `shape`: −1 stands for any length. InputError naming `name` for another shape, and for values that are not
/// numbers.
void check_shape(const py::array& array, const std::string& name, const Shape& shape);

/// The array in T, contiguous: in place if it has that layout, otherwise a copy.
template <class T>
py::array_t<T, py::array::c_style | py::array::forcecast> array_of(const py::handle& values,
                                                                   const std::string& name,
                                                                   const Shape& shape) {
  const py::array any = any_array(values, name);
  check_shape(any, name, shape);
  return py::array_t<T, py::array::c_style | py::array::forcecast>(any);
}

/// An array's numbers in place, with any strides.
template <class T>
struct Strided {
  const char* data = nullptr;
  std::array<std::ptrdiff_t, 4> strides{};  ///< bytes; 0 beyond its dimensions

  double at(int i, int j, int k) const {
    T value;
    std::memcpy(&value, data + strides[0] * i + strides[1] * j + strides[2] * k, sizeof value);
    return double(value);
  }
  /// Element i of the first dimension.
  Strided part(std::size_t i) const {
    return {data + strides[0] * ssize(i), {strides[1], strides[2], strides[3], 0}};
  }
};

/// Calls read(Strided) on `array` in place if it is of float or double, otherwise on a copy in double. At
/// most four dimensions. InputError as check_shape's.
template <class Read>
void read_in_place(py::array array, const std::string& name, const Shape& shape, const Read& read) {
  check_shape(array, name, shape);
  const bool is_float = py::isinstance<py::array_t<float>>(array);
  if (!is_float && !py::isinstance<py::array_t<double>>(array)) array = array_of<double>(array, name, shape);
  const auto in = [&]<class T>(Strided<T> from) {
    from.data = static_cast<const char*>(array.data());
    std::copy_n(array.strides(), array.ndim(), from.strides.begin());
    read(from);
  };
  if (is_float)
    in(Strided<float>());
  else
    in(Strided<double>());
}

/// Copies `count` channels of the pixels of `rect` to pixel(u, v). False if a number is not finite.
template <class T, class Pixel>
bool take(const Strided<T>& from, const PixelRect& rect, int count, const Pixel& pixel) {
  bool finite = true;
  for (int v = rect.v0; v < rect.v1; ++v)
    for (int u = rect.u0; u < rect.u1; ++u) {
      auto* to = pixel(u, v);
      for (int c = 0; c < count; ++c, ++to) {
        const double value = from.at(v, u, c);
        finite &= std::isfinite(value);
        *to = static_cast<std::remove_reference_t<decltype(*to)>>(value);
      }
    }
  return finite;
}

/// Rows of three numbers. InputError naming `name` if the array does not hold whole rows.
std::vector<Vec3d> rows_of_three(const py::handle& values, const std::string& name);

/// F × 3 indices. InputError as array_of's.
std::vector<Face> faces_of(const py::handle& values);

/// InputError for a texel outside [0, 1] by more than the step of a central difference.
void check_albedo(std::span<const Vec3d> texels);

}  // namespace mirage::python
