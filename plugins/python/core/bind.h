// The module's parts; each adds its classes and functions.
#pragma once

#include <pybind11/functional.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

namespace mirage::python {

namespace py = pybind11;

void bind_frames(py::module_& module);
void bind_meshes(py::module_& module);
void bind_insertion(py::module_& module);
void bind_rasterizer(py::module_& module);
void bind_rays(py::module_& module);
void bind_commands(py::module_& module);

}  // namespace mirage::python
