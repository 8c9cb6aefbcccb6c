// The one place where C++ meets Python.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <atomic>
#include <memory>
#include <stdexcept>

#include <poise/unlocked.hpp>

#include "tree.h"
#include "greedy.h"
#include "relaxation.h"
#include "read_arrays.h"
#include "search.h"

namespace nb = nanobind;
using namespace poise;

namespace {

constexpr double kLeast = 1e-30, kMost = 1e30;  // as in poise.plan.problem.problem

const char* named(Reason reason) {
  switch (reason) {
    case Reason::kDone: return "done";
    case Reason::kProven: return "proven";
    case Reason::kBudget: return "budget";
    case Reason::kInterrupted: return "interrupted";
    case Reason::kInfeasible: return "infeasible";
  }
  return "done";
}

// Whether the user pressed Ctrl-C, or `ask` says so. Any other exception of a signal
// handler, or of `ask`, is passed on by `Core`, once the solver has come back.
struct Asked {
  nb::handle ask;  // a callable, or None
  nb::object raised;
  bool operator()() {
    const Locked lock;
    if (PyErr_CheckSignals() != 0) return keep();
    if (ask.is_none()) return false;
    const nb::object answer = nb::steal(PyObject_CallNoArgs(ask.ptr()));
    const int truth = answer.is_valid() ? PyObject_IsTrue(answer.ptr()) : -1;
    return truth < 0 ? keep() : truth > 0;
  }
  bool keep() {
    if (!PyErr_ExceptionMatches(PyExc_KeyboardInterrupt)) {
      PyObject *type, *value, *trace;
      PyErr_Fetch(&type, &value, &trace);
      PyErr_NormalizeException(&type, &value, &trace);
      Py_XDECREF(type);
      Py_XDECREF(trace);
      raised = nb::steal<nb::object>(value);
    }
    PyErr_Clear();
    return true;
  }
};

// A problem compiled once, and its solvers; it never changes. One thread at a time may use it.
class Core {
 public:
  explicit Core(const Fields& in)
      : unit_of_(in.get<std::vector<std::int32_t>>("unit_of")), problem_(read(in, unit_of_)),
        greedy_(problem_), index_(in.get<nb::dict>("index")),
        resources_(in.get<nb::tuple>("resources")),
        demand_(in.numbers("component_demand", unit_of_.size() * problem_.r)) {
    if (nb::len(index_) != unit_of_.size() ||
        nb::len(resources_) > static_cast<std::size_t>(problem_.r)) {
      throw std::invalid_argument("unit_of, index and resources do not agree");
    }
    for (const auto& [name, at] : index_) {
      Fields::check_index("index", nb::cast<std::int64_t>(at), unit_of_.size());
    }
    sum_demand();
  }

  // Another one with other demands: component -> resource -> amount.
  Core(const Core& other, nb::dict demands)
      : unit_of_(other.unit_of_), problem_(other.problem_), greedy_(problem_),
        index_(other.index_), resources_(other.resources_), demand_(other.demand_) {
    for (const auto& [name, amounts] : demands) {
      PyObject* at = PyDict_GetItemWithError(index_.ptr(), name.ptr());
      if (at == nullptr) {
        throw std::invalid_argument("no component is called " + text(name));
      }
      const auto first = static_cast<std::size_t>(PyLong_AsLong(at)) * problem_.r;
      for (const auto& [resource, amount] : nb::cast<nb::dict>(amounts)) {
        const double value = PyFloat_AsDouble(amount.ptr());
        if (value == -1.0 && PyErr_Occurred()) throw nb::python_error();
        if (!(value == 0 || (value >= kLeast && value <= kMost))) {
          throw std::invalid_argument("component " + text(name) + ": demand of " +
                                      text(resource) + " is " + text(amount) +
                                      ", must be 0, or in [1e-30, 1e+30]");
        }
        demand_[first + resource_index(resource, name)] = value;
      }
    }
    sum_demand();
  }

  nb::tuple greedy() {
    bool complete;
    if (static_cast<double>(problem_.n) * problem_.m < 65536) {
      complete = greedy_.run(placed_);
    } else {  // long enough for other threads to run meanwhile
      const Busy busy(*this);
      const Unlocked unlocked;
      complete = greedy_.run(placed_);
    }
    return nb::make_tuple(listed(placed_), complete);
  }

  nb::tuple exact(nb::handle known, double seconds, std::int64_t steps, nb::handle stop) {
    const Placement start = complete(known);
    if (!provable()) throw std::invalid_argument("too large for `exact`");
    if (!start.empty() && !feasible(problem_, start)) {
      throw std::invalid_argument("the placement to start from breaks a limit");
    }
    return solve(seconds, steps, stop, [&](Stop& until) {
      if (!exact_) exact_ = Tree::of(problem_);
      return exact_->run(start, until);
    });
  }

  nb::tuple search(nb::handle known, double seconds, std::int64_t steps,
                   std::uint64_t seed, nb::handle stop) {
    const Placement start = complete(known);
    return solve(seconds, steps, stop, [&](Stop& until) {
      return poise::search(problem_, start, until, seed);
    });
  }

  nb::tuple terms(nb::handle known) {
    const Terms out = poise::terms(problem_, checked(known, -1));
    return nb::make_tuple(out.communication, out.balance, out.linear, out.shortage,
                          out.time);
  }

  bool keeps_limits(nb::handle known) { return feasible(problem_, checked(known, -1)); }
  nb::list order() { return listed(problem_.order); }
  nb::list demand() { return list_of(demand_, PyFloat_FromDouble); }
  bool provable() { return Tree::takes(problem_); }
  double bound() { return relaxation_bound(problem_); }

 private:
  // Bring the demand of units up to date with that of their components.
  void sum_demand() {
    const std::size_t r = problem_.r;
    problem_.demand.assign(problem_.n * r, 0.0);
    for (std::size_t i = 0; i < unit_of_.size(); ++i) {
      for (std::size_t k = 0; k < r; ++k) {
        problem_.demand[unit_of_[i] * r + k] += demand_[i * r + k];
      }
    }
    if (problem_.time_limits) problem_.time_limits->set_own(demand_, problem_.r);
    problem_.sort_units();
  }

  // Refuses a second thread, which would change what the first one works on.
  struct Busy {
    explicit Busy(Core& core) : busy(core.busy_) {
      if (busy.exchange(true)) throw std::invalid_argument("a solver is running already");
    }
    ~Busy() { busy = false; }
    std::atomic<bool>& busy;
  };

  template <typename Solver>
  nb::tuple solve(double seconds, std::int64_t steps, nb::handle stop, Solver solver) {
    if (!(seconds >= 0)) throw std::invalid_argument("seconds must be >= 0");
    const Busy busy(*this);
    Asked asked{stop, {}};
    Outcome out;
    {
      const Unlocked unlocked;
      Stop until(seconds, steps, [&] { return asked(); });
      out = solver(until);
    }
    if (asked.raised.is_valid()) {
      PyErr_SetObject(reinterpret_cast<PyObject*>(Py_TYPE(asked.raised.ptr())),
                      asked.raised.ptr());
      throw nb::python_error();
    }
    return nb::make_tuple(listed(out.placed), out.bound, out.proven, named(out.reason),
                          out.steps);
  }

  static std::string text(nb::handle value) { return nb::repr(value).c_str(); }

  int resource_index(nb::handle resource, nb::handle component) {
    const auto resources = static_cast<int>(nb::len(resources_));
    for (int k = 0; k < resources; ++k) {  // columns of soft limits have no name
      PyObject* known = PyTuple_GetItem(resources_.ptr(), k);
      if (known == resource.ptr() || resource.equal(nb::handle(known))) return k;
    }
    throw std::invalid_argument("component " + text(component) + ": no resource is called " +
                                text(resource));
  }

  template <typename T, typename Make>
  static nb::list list_of(const std::vector<T>& values, Make make) {
    PyObject* list = PyList_New(static_cast<Py_ssize_t>(values.size()));
    if (list == nullptr) throw nb::python_error();
    for (std::size_t i = 0; i < values.size(); ++i) {
      PyList_SetItem(list, static_cast<Py_ssize_t>(i), make(values[i]));
    }
    return nb::steal<nb::list>(list);
  }
  static nb::list listed(const Placement& placed) { return list_of(placed, PyLong_FromLong); }

  // A placement of all units, or of none.
  Placement complete(nb::handle from) {
    if (nb::len(from) == 0) return {};
    return checked(from, 0);
  }

  Placement checked(nb::handle from, int lowest) {
    Placement placed = nb::cast<Placement>(from);
    if (placed.size() != static_cast<std::size_t>(problem_.n)) {
      throw std::invalid_argument("placement has " + std::to_string(placed.size()) +
                                  " entries, must have " + std::to_string(problem_.n));
    }
    for (const std::int32_t computer : placed) {
      if (computer >= lowest && computer < problem_.m) continue;
      throw std::invalid_argument("placement has the computer " + std::to_string(computer));
    }
    return placed;
  }

  std::vector<std::int32_t> unit_of_;
  Problem problem_;
  Greedy greedy_;
  nb::dict index_;       // component -> its place in `unit_of_`
  nb::tuple resources_;
  std::vector<double> demand_;  // (components, r)
  std::unique_ptr<Tree> exact_;
  Placement placed_;
  std::atomic<bool> busy_{false};
};

}  // namespace

NB_MODULE(_core, module) {
  nb::set_leak_warnings(false);  // a thread may search while the interpreter ends
  module.doc() = "The placement engine in C++; see poise.plan.planner.";
  nb::class_<Core>(module, "Core", "A problem compiled from `Arrays`, and its solvers.")
      .def("__init__",
           [](Core* self, nb::handle arrays) { new (self) Core(Fields{arrays}); },
           nb::arg("arrays"), nb::sig("def __init__(self, arrays: object) -> None"))
      .def("greedy", &Core::greedy,
           nb::sig("def greedy(self) -> tuple[list[int], bool]"))
      .def("exact", &Core::exact, nb::arg("known"), nb::arg("seconds"), nb::arg("steps"),
           nb::arg("stop").none() = nb::none(),
           nb::sig("def exact(self, known: list[int], seconds: float, steps: int, stop: "
                   "object = None) -> tuple[list[int], float, bool, str, int]"))
      .def("search", &Core::search, nb::arg("known"), nb::arg("seconds"),
           nb::arg("steps"), nb::arg("seed"), nb::arg("stop").none() = nb::none(),
           nb::sig("def search(self, known: list[int], seconds: float, steps: int, seed: "
                   "int, stop: object = None) -> tuple[list[int], float, bool, str, int]"))
      .def("updated",
           [](const Core& self, nb::dict demands) { return new Core(self, demands); },
           nb::arg("demands"),
           nb::sig("def updated(self, demands: dict[str, dict[str, float]]) -> Core"))
      .def("terms", &Core::terms, nb::arg("placed"),
           nb::sig("def terms(self, placed: list[int]) -> tuple[float, float, float, float, "
                   "float]"))
      .def("feasible", &Core::keeps_limits, nb::arg("placed"),
           nb::sig("def feasible(self, placed: list[int]) -> bool"))
      .def("bound", &Core::bound, nb::sig("def bound(self) -> float"))
      .def_prop_ro("order", &Core::order, nb::sig("def order(self) -> list[int]"))
      .def_prop_ro("demand", &Core::demand, nb::sig("def demand(self) -> list[float]"))
      .def_prop_ro("provable", &Core::provable);
}
