// What Python sees; `make stubs` writes src/poise/estimate/_change_point.pyi from it.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>

#include "change_point.h"

namespace nb = nanobind;
using namespace poise;

NB_MODULE(_change_point, module) {
  nb::set_leak_warnings(false);  // containers end without finalising the interpreter
  module.doc() = "Detects changes of a rate; native/change_point.h explains the method.";
  // Windows to learn the noise from, and the reference if none is given.
  module.attr("LEARN") = ChangePointDetector::learn;
  // Deviations of up to this many windows are outliers, whatever their size.
  module.attr("OUTLIER") = ChangePointDetector::outlier;

  nb::class_<ChangePointDetector>(module, "ChangePointDetector",
                                  R"(Watches ``value / exposure``, such as CPU time per second or per job.

Parameters
----------
reference
    The expected rate. None: it is learned from the first 150 windows, and used
    after the first `LEARN`.)")
      .def(nb::init<std::optional<double>>(), nb::arg("reference").none() = nb::none())
      .def("update", &ChangePointDetector::update, nb::arg("value"), nb::arg("exposure"),
           nb::sig("def update(self, value: float, exposure: float) -> "
                   "typing.Literal[-1, 0, 1]"),
           "Add a window; return 1 or -1 when the rate has risen or fallen, else 0.")
      .def_prop_ro("reference", &ChangePointDetector::reference,
                   "The expected rate; None until it is learned.")
      .def_prop_ro("since", &ChangePointDetector::since,
                   "How many windows ago the last change began.");
}
