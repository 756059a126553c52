// The compiled half of the Python package `mirage`.
#include <dlfcn.h>

#include "base/error.h"
#include "base/files.h"
#include "base/logging.h"
#include "base/parallel.h"
#include "bind.h"

namespace mirage::python {
namespace {

/// This library: shipped files and plugins are looked for beside it.
std::filesystem::path own_file() {
  Dl_info info{};
  static const int here = 0;
  if (dladdr(&here, &info) == 0 || !info.dli_fname)
    throw Failure("mirage", "cannot tell where its own library is", "import it from a file");
  return info.dli_fname;
}

/// A Python class of the package, as the C++ type's.
template <class Error>
void register_error(py::module_& module, const char* name, PyObject* base, const char* help) {
  auto& type = py::register_exception<Error>(module, name, base);
  type.attr("__module__") = "mirage";
  type.attr("__doc__") = help;
}

}  // namespace

PYBIND11_MODULE(_core, module) {
  module.doc() = "Mirage's simulator; use it through the package mirage.";
  set_program_file(own_file());
  start_logging(true);
  register_error<InputError>(module, "InputError", PyExc_ValueError,
                             "Something in the input is wrong. The message names it and says how to fix it.");
  register_error<Failure>(module, "Failure", PyExc_RuntimeError,
                          "The work failed although the input was right.");
  py::register_exception_translator([](std::exception_ptr problem) {
    try {
      if (problem) std::rethrow_exception(problem);
    } catch (const Interrupted& stop) {
      PyErr_SetString(PyExc_KeyboardInterrupt, stop.what());
    }
  });
  module.attr("version") = MIRAGE_VERSION;
  module.attr("libtorch_version") = MIRAGE_LIBTORCH_VERSION;
  module.def("set_thread_count", &set_thread_count, py::arg("threads"));
  bind_frames(module);
  bind_meshes(module);
  bind_insertion(module);
  bind_rasterizer(module);
  bind_rays(module);
  bind_commands(module);
}

}  // namespace mirage::python
