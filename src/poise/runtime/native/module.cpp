// What Python sees; src/poise/runtime/_calls.pyi describes it.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

#include "direct_call.h"
#include "turn.h"

namespace nb = nanobind;
using namespace poise;

static void check(const Turn& turn, Entry entry, double limit, const char* action) {
  if (entry == Entry::entered || entry == Entry::late) return;
  set_entry_error(turn.what(), static_cast<int>(entry), limit, action);
  throw nb::python_error();
}

static void require(bool was_held) {
  if (!was_held) throw std::runtime_error("nobody has the turn");
}

NB_MODULE(_calls, module) {
  nb::set_leak_warnings(false);  // containers end without finalising the interpreter

  module.def("begin_chains", &begin_chains, nb::arg("first"));
  module.def("new_chain", &new_chain);
  module.def("join_chain", [](Chain chain) { thread_chain = chain; }, nb::arg("chain"));
  module.def("current_chain", &current_chain);

  nb::class_<Turn>(module, "Turn")
      .def(nb::init<std::string>(), nb::arg("what"))
      .def_prop_ro("is_retired", &Turn::is_retired)
      .def(
          "enter",
          [](Turn& turn, Chain chain, double limit) {
            check(turn, turn.enter(chain, limit), limit, "was busy for");
          },
          nb::arg("chain"), nb::arg("limit"))
      .def("try_enter", &Turn::try_enter, nb::arg("chain"))
      .def("leave", [](Turn& turn) { require(turn.leave()); })
      .def("step_out", &Turn::step_out, nb::arg("chain"))
      .def(
          "step_in",
          [](Turn& turn, Chain chain, int depth, double limit) {
            check(turn, turn.step_in(chain, depth, limit), limit, "was busy for");
          },
          nb::arg("chain"), nb::arg("depth"), nb::arg("limit"))
      .def("lend", &Turn::lend, nb::arg("chain"))
      .def("open", [](Turn& turn) { require(turn.open()); })
      .def(
          "shut",
          [](Turn& turn, double limit) {
            check(turn, turn.shut(limit), limit, "did not come to rest in");
          },
          nb::arg("limit"))
      .def("retire", &Turn::retire);

  nb::class_<Histogram>(module, "Histogram")
      .def(nb::init<>())
      .def("add", &Histogram::add, nb::arg("value"))
      .def("summary", [](const Histogram& histogram) {
        return nb::module_::import_("poise.wire.messages")
            .attr("Summary")(histogram.count(), histogram.mean(), histogram.quantile(0.5),
                             histogram.quantile(0.99), histogram.maximum());
      });

  nb::class_<Counts>(module, "Counts")
      .def(nb::init<>())
      .def_rw("calls", &Counts::calls)
      .def_rw("messages", &Counts::messages)
      .def_rw("bytes_out", &Counts::bytes_out)
      .def_rw("bytes_in", &Counts::bytes_in)
      .def_rw("errors", &Counts::errors)
      .def_rw("drops", &Counts::drops)
      .def_ro("delay", &Counts::delay)
      .def_ro("wait", &Counts::wait)
      .def("add_call", &Counts::add_call, nb::arg("seconds"), nb::arg("bytes_out") = 0,
           nb::arg("bytes_in") = 0, nb::arg("failed") = false)
      .def("add_message", &Counts::add_message, nb::arg("bytes_out") = 0,
           nb::arg("bytes_in") = 0)
      .def_prop_ro("cpu", [](const Counts& counts) { return counts.cpu.seconds(); })
      .def(
          "add_cpu",
          [](Counts& counts, double seconds) {
            const auto time = static_cast<std::int64_t>(1e9 * seconds);
            counts.cpu.add_measured(wall_now(), time, time);
          },
          nb::arg("seconds"));

  module.attr("DirectCall") = make_direct_call_type();
}
