// The one place where C++ meets Python.
#include <nanobind/nanobind.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <atomic>
#include <memory>
#include <stdexcept>

#include "exact/tree.h"
#include "greedy.h"
#include "problem/relaxation.h"
#include "search/search.h"

namespace nb = nanobind;
using namespace poise;

namespace {

constexpr double kLeast = 1e-30, kMost = 1e30;  // as in poise.plan.problem.check

// Reads the fields of `poise.plan.problem.arrays.Arrays`.
Numbers read(nb::handle arrays) {
  Numbers in;
  const auto get = [&](auto& to, const char* name) {
    to = nb::cast<std::decay_t<decltype(to)>>(arrays.attr(name));
  };
  get(in.n, "n");
  get(in.m, "m");
  get(in.r, "r");
  get(in.demand, "demand");
  get(in.capacity, "capacity");
  get(in.limit, "limit");
  get(in.size_weight, "size_weight");
  get(in.first, "first");
  get(in.second, "second");
  get(in.overhead, "overhead");
  get(in.traffic, "traffic");
  get(in.distance, "distance");
  get(in.cost, "cost");
  get(in.bandwidth, "bandwidth");
  get(in.communication, "communication");
  get(in.spread, "spread");
  get(in.share, "share");
  get(in.variance, "variance");
  for (const auto& [unit, computers] : nb::cast<nb::dict>(arrays.attr("allowed"))) {
    in.allowed.emplace_back(nb::cast<std::int32_t>(unit),
                            nb::cast<std::vector<std::int32_t>>(computers));
  }
  for (const nb::handle pair : arrays.attr("apart")) {
    const auto [a, b] = nb::cast<std::pair<std::int32_t, std::int32_t>>(pair);
    in.apart_first.push_back(a);
    in.apart_second.push_back(b);
  }
  return in;
}

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
    nb::gil_scoped_acquire lock;
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

// A problem compiled once, and its solvers. One thread at a time may use it.
class Core {
 public:
  explicit Core(nb::handle arrays)
      : problem_(read(arrays)), greedy_(problem_), index_(nb::cast<nb::dict>(arrays.attr("index"))),
        resources_(nb::cast<nb::tuple>(arrays.attr("resources"))),
        unit_of_(nb::cast<std::vector<std::int32_t>>(arrays.attr("unit_of"))),
        demand_(nb::cast<std::vector<double>>(arrays.attr("component_demand"))) {
    if (demand_.size() != unit_of_.size() * problem_.r || nb::len(index_) != unit_of_.size() ||
        nb::len(resources_) != static_cast<std::size_t>(problem_.r)) {
      throw std::invalid_argument("component_demand, unit_of and index do not agree");
    }
    for (const std::int32_t unit : unit_of_) {
      if (unit < 0 || unit >= problem_.n) throw std::invalid_argument("no such unit");
    }
    for (const auto& [name, at] : index_) {
      if (nb::cast<std::size_t>(at) >= unit_of_.size()) {
        throw std::invalid_argument("no such component");
      }
    }
  }

  nb::tuple greedy() {
    bool complete;
    if (static_cast<double>(problem_.n) * problem_.m < 65536) {
      complete = greedy_.run(placed_);
    } else {  // long enough for other threads to run meanwhile
      const Busy busy(*this);
      nb::gil_scoped_release free;
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

  // Change demands: component -> resource -> amount; returns all of them, as they are
  // then. All is checked before any changes.
  nb::list update(nb::dict demands) {
    const Busy busy(*this);
    std::vector<std::pair<std::size_t, double>> changes;
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
        changes.emplace_back(first + resource_index(resource, name), value);
      }
    }
    for (const auto& [entry, value] : changes) demand_[entry] = value;
    std::fill(problem_.demand.begin(), problem_.demand.end(), 0.0);
    for (std::size_t i = 0; i < unit_of_.size(); ++i) {
      for (int k = 0; k < problem_.r; ++k) {
        problem_.demand[static_cast<std::size_t>(unit_of_[i]) * problem_.r + k] +=
            demand_[i * problem_.r + k];
      }
    }
    problem_.sort_units();
    exact_.reset();
    return list_of(demand_, PyFloat_FromDouble);
  }

  nb::tuple terms(nb::handle known) {
    const Terms out = poise::terms(problem_, checked(known, -1));
    return nb::make_tuple(out.communication, out.balance, out.linear);
  }

  bool keeps_limits(nb::handle known) { return feasible(problem_, checked(known, -1)); }
  nb::list order() { return listed(problem_.order); }
  bool provable() { return Tree::takes(problem_); }
  double bound() { return relaxation_bound(problem_); }

 private:
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
      nb::gil_scoped_release free;
      Stop until(seconds, steps, [&] { return asked(); });
      out = solver(until);
    }
    if (asked.raised.is_valid()) {
      PyErr_SetObject(reinterpret_cast<PyObject*>(Py_TYPE(asked.raised.ptr())),
                      asked.raised.ptr());
      throw nb::python_error();
    }
    return nb::make_tuple(listed(out.placed), out.objective, out.bound, out.proven,
                          named(out.reason), out.steps);
  }

  static std::string text(nb::handle value) { return nb::repr(value).c_str(); }

  int resource_index(nb::handle resource, nb::handle component) {
    for (int k = 0; k < problem_.r; ++k) {
      PyObject* known = PyTuple_GET_ITEM(resources_.ptr(), k);
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
      PyList_SET_ITEM(list, static_cast<Py_ssize_t>(i), make(values[i]));
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

  Problem problem_;
  Greedy greedy_;
  nb::dict index_;       // component -> its place in `unit_of_`
  nb::tuple resources_;
  std::vector<std::int32_t> unit_of_;
  std::vector<double> demand_;  // (components, r)
  std::unique_ptr<Tree> exact_;
  Placement placed_;
  std::atomic<bool> busy_{false};
};

}  // namespace

NB_MODULE(_core, module) {
  module.doc() = "The placement engine in C++; see poise.plan.planner.";
  nb::class_<Core>(module, "Core", "A problem compiled from `Arrays`, and its solvers.")
      .def(nb::init<nb::handle>(), nb::arg("arrays"))
      .def("greedy", &Core::greedy,
           nb::sig("def greedy(self) -> tuple[list[int], bool]"))
      .def("exact", &Core::exact, nb::arg("known"), nb::arg("seconds"), nb::arg("steps"),
           nb::arg("stop").none() = nb::none(),
           nb::sig("def exact(self, known: list[int], seconds: float, steps: int, stop: "
                   "object = None) -> tuple[list[int], float, float, bool, str, int]"))
      .def("search", &Core::search, nb::arg("known"), nb::arg("seconds"),
           nb::arg("steps"), nb::arg("seed"), nb::arg("stop").none() = nb::none(),
           nb::sig("def search(self, known: list[int], seconds: float, steps: int, seed: "
                   "int, stop: object = None) -> "
                   "tuple[list[int], float, float, bool, str, int]"))
      .def("update", &Core::update, nb::arg("demands"),
           nb::sig("def update(self, demands: dict[str, dict[str, float]]) -> list[float]"))
      .def("terms", &Core::terms, nb::arg("placed"),
           nb::sig("def terms(self, placed: list[int]) -> tuple[float, float, float]"))
      .def("feasible", &Core::keeps_limits, nb::arg("placed"),
           nb::sig("def feasible(self, placed: list[int]) -> bool"))
      .def("bound", &Core::bound, nb::sig("def bound(self) -> float"))
      .def_prop_ro("order", &Core::order, nb::sig("def order(self) -> list[int]"))
      .def_prop_ro("provable", &Core::provable);
}
