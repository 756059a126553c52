// NumPy arrays over Mirage's memory, and Mirage's types out of other people's arrays.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <memory>
#include <string>
#include <vector>

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

/// An array that owns what was computed for it.
template <class T>
py::array_t<T> own(std::vector<T> values, const Shape& shape) {
  const auto kept = std::make_shared<std::vector<T>>(std::move(values));
  return view(kept->data(), shape, kept, true);
}

inline py::ssize_t ssize(std::size_t size) {
  return static_cast<py::ssize_t>(size);
}

/// A CPU array out of a NumPy array, anything with __dlpack__ or nested lists. InputError naming `name`.
py::array any_array(const py::handle& values, const std::string& name);

/// `shape`: −1 stands for any length. InputError naming `name` for another shape, and for what are no
/// numbers.
void check_shape(const py::array& array, const std::string& name, const Shape& shape);

/// The same in T, contiguous: as it lies in memory where it has that layout, else a copy.
template <class T>
py::array_t<T, py::array::c_style | py::array::forcecast> array_of(const py::handle& values,
                                                                   const std::string& name,
                                                                   const Shape& shape) {
  const py::array any = any_array(values, name);
  check_shape(any, name, shape);
  return py::array_t<T, py::array::c_style | py::array::forcecast>(any);
}

/// Rows of three numbers. InputError naming `name` if the array does not hold whole rows.
std::vector<Vec3d> rows_of_three(const py::handle& values, const std::string& name);

}  // namespace mirage::python
