// What Python sees; src/poise/estimate/_shift.pyi describes it.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>

#include "shift.h"

namespace nb = nanobind;
using namespace poise;

NB_MODULE(_shift, module) {
  module.attr("LEARN") = Shift::learn;
  module.attr("DISTURBANCE") = Shift::disturbance;

  nb::class_<Shift>(module, "Shift")
      .def(nb::init<std::optional<double>>(), nb::arg("reference").none() = nb::none())
      .def("update", &Shift::update, nb::arg("value"), nb::arg("exposure"))
      .def_prop_ro("reference", &Shift::reference)
      .def_prop_ro("since", &Shift::since);
}
