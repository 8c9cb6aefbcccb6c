// What Python sees; src/poise/estimate/_change_point.pyi describes it.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>

#include "change_point.h"

namespace nb = nanobind;
using namespace poise;

NB_MODULE(_change_point, module) {
  module.attr("LEARN") = ChangePointDetector::learn;
  module.attr("OUTLIER") = ChangePointDetector::outlier;

  nb::class_<ChangePointDetector>(module, "ChangePointDetector")
      .def(nb::init<std::optional<double>>(), nb::arg("reference").none() = nb::none())
      .def("update", &ChangePointDetector::update, nb::arg("value"), nb::arg("exposure"))
      .def_prop_ro("reference", &ChangePointDetector::reference)
      .def_prop_ro("since", &ChangePointDetector::since);
}
