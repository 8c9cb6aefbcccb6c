// The one place where C++ meets Python.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cstring>
#include <memory>
#include <mutex>
#include <stdexcept>

#include "exact.h"
#include "fleet.h"
#include "fluid.h"
#include "greedy.h"
#include "search.h"
#include "state.h"

namespace nb = nanobind;
using namespace poise;

namespace {

// Copies a list, or anything with a buffer of the right type (array.array, NumPy).
template <typename T>
std::vector<T> numbers(nb::handle from, const char* name) {
  std::vector<T> out;
  if (PyList_CheckExact(from.ptr())) {
    const Py_ssize_t size = PyList_GET_SIZE(from.ptr());
    out.resize(static_cast<std::size_t>(size));
    for (Py_ssize_t i = 0; i < size; ++i) {
      PyObject* item = PyList_GET_ITEM(from.ptr(), i);
      if constexpr (std::is_same_v<T, double>) {
        out[i] = PyFloat_AsDouble(item);
        if (out[i] == -1.0 && PyErr_Occurred()) throw nb::python_error();
      } else {
        const long value = PyLong_AsLong(item);
        if (value == -1 && PyErr_Occurred()) throw nb::python_error();
        if (value != static_cast<T>(value)) {
          throw std::invalid_argument(std::string(name) + " has an index out of range");
        }
        out[i] = static_cast<T>(value);
      }
    }
    return out;
  }
  Py_buffer view;
  if (PyObject_GetBuffer(from.ptr(), &view, PyBUF_FORMAT | PyBUF_C_CONTIGUOUS) != 0) {
    throw nb::python_error();
  }
  const char* wanted = std::is_same_v<T, double> ? "d" : "i";
  const bool right = view.format != nullptr && std::strcmp(view.format, wanted) == 0 &&
                     view.itemsize == sizeof(T);
  if (right) {
    out.resize(static_cast<std::size_t>(view.len) / sizeof(T));
    if (view.len > 0) std::memcpy(out.data(), view.buf, static_cast<std::size_t>(view.len));
  }
  PyBuffer_Release(&view);
  if (!right) throw std::invalid_argument(std::string(name) + " has the wrong type");
  return out;
}

// The interpreter's numbers from -1 to `m` - 1, made once: a short list of them then costs
// no more than counting references.
class Computers {
 public:
  explicit Computers(int m) {
    for (int h = -1; h < m && h < kMost; ++h) numbers_.push_back(nb::int_(h));
  }

  nb::list listed(const Placement& placed) const {
    PyObject* list = PyList_New(static_cast<Py_ssize_t>(placed.size()));
    if (list == nullptr) throw nb::python_error();
    const auto made = static_cast<int>(numbers_.size()) - 1;
    for (std::size_t i = 0; i < placed.size(); ++i) {
      const int h = placed[i];
      PyObject* number =
          h < made ? numbers_[h + 1].inc_ref().ptr() : PyLong_FromLong(h);
      PyList_SET_ITEM(list, static_cast<Py_ssize_t>(i), number);
    }
    return nb::steal<nb::list>(list);
  }

 private:
  static constexpr int kMost = 64;
  std::vector<nb::object> numbers_;
};

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

class Core {
 public:
  explicit Core(Input input)
      : problem_(std::move(input)), greedy_(problem_), computers_(problem_.m) {}

  nb::list greedy() {
    if (static_cast<double>(problem_.n) * problem_.m < 65536) {
      greedy_.run(placed_);
      return computers_.listed(placed_);
    }
    // Long enough for others to run meanwhile; then it needs tables of its own.
    Placement placed;
    {
      nb::gil_scoped_release free;
      Greedy(problem_).run(placed);
    }
    return computers_.listed(placed);
  }

  // How long a decision by the greedy takes with no Python around it, on average [s].
  double rehearse(int times) {
    if (times < 1) throw std::invalid_argument("times must be >= 1");
    nb::gil_scoped_release free;
    Greedy greedy(problem_);
    Placement placed;
    const Stop watch(0.0, 1, nullptr);
    for (int i = 0; i < times; ++i) greedy.run(placed);
    return watch.elapsed() / times;
  }

  nb::tuple exact(nb::handle known, double seconds, std::int64_t steps,
                  nb::handle ask) {
    const Placement start = complete(known);
    if (!Exact::takes(problem_)) throw std::invalid_argument("too large for `exact`");
    if (!start.empty() && !feasible(problem_, start)) {
      throw std::invalid_argument("the placement to start from breaks a limit");
    }
    return solve(seconds, steps, ask, [&](Stop& stop) {
      // One prepared tree is kept; a second thread that comes meanwhile grows its own.
      const std::unique_lock<std::mutex> lock(exact_mutex_, std::try_to_lock);
      if (!lock) return Exact(problem_).run(start, stop);
      if (!exact_) exact_ = std::make_unique<Exact>(problem_);
      return exact_->run(start, stop);
    });
  }

  nb::tuple search(nb::handle known, double seconds, std::int64_t steps,
                   std::uint64_t seed, nb::handle ask, bool thread_time) {
    const Placement start = complete(known);
    return solve(seconds, steps, ask, [&](Stop& stop) {
      return poise::search(problem_, start, stop, seed);
    }, thread_time ? Clock::kThread : Clock::kWall);
  }

  // Apply search moves one by one: what each was weighed at, and what is kept after it.
  nb::list walk(nb::handle known, nb::list moves) {
    const Placement start = partial(known);
    check(start, 0);
    State state(problem_);
    state.reset(start);
    nb::list out;
    for (const nb::handle item : moves) {
      const nb::tuple move = nb::cast<nb::tuple>(item);
      if (move.size() != 4) throw std::invalid_argument("a move is (out, back, a, b)");
      const int a = nb::cast<int>(move[2]), b = nb::cast<int>(move[3]);
      if (a == b) throw std::invalid_argument("a move joins two computers");
      const Units there = moving(state, move[0], a), back = moving(state, move[1], b);
      const Change change = state.weigh(there, back, a, b);
      state.apply(there, back, a, b);
      out.append(nb::make_tuple(change.objective, change.excess, state.paid(),
                                state.balance(), state.excess(), state.feasible()));
    }
    return out;
  }

  nb::list multilevel(std::uint64_t seed) {
    Placement placed;
    {
      nb::gil_scoped_release free;
      Stop stop(1e18, std::int64_t{1} << 62, nullptr);
      Random random(seed);
      placed = poise::multilevel(problem_, stop, random);
    }
    return computers_.listed(placed);
  }

  nb::tuple terms(nb::handle known) {
    const Terms out = poise::terms(problem_, partial(known));
    return nb::make_tuple(out.communication, out.balance, out.linear);
  }

  bool feasible_(nb::handle known) { return feasible(problem_, partial(known)); }

  bool provable() { return Exact::takes(problem_); }
  double bound() { return fluid_bound(problem_); }
  std::size_t bytes() { return problem_.bytes(); }

 private:
  template <typename Solver>
  nb::tuple solve(double seconds, std::int64_t steps, nb::handle ask, Solver solver,
                  Clock clock = Clock::kWall) {
    if (!(seconds >= 0)) throw std::invalid_argument("seconds must be >= 0");
    Asked asked{ask, {}};
    Outcome out;
    {
      nb::gil_scoped_release free;
      Stop stop(seconds, steps, [&] { return asked(); }, clock);
      out = solver(stop);
    }
    if (asked.raised.is_valid()) {
      PyErr_SetObject(reinterpret_cast<PyObject*>(Py_TYPE(asked.raised.ptr())),
                      asked.raised.ptr());
      throw nb::python_error();
    }
    return nb::make_tuple(computers_.listed(out.placed), out.bound, out.proven,
                          named(out.reason), out.steps);
  }

  Units moving(const State& state, nb::handle from, int computer) {
    Units units = numbers<std::int32_t>(from, "move");
    std::vector<char> seen(problem_.n, 0);
    if (computer < 0 || computer >= problem_.m) throw std::invalid_argument("no computer");
    for (const std::int32_t unit : units) {
      const bool known = unit >= 0 && unit < problem_.n && !seen[unit];
      if (!known || state.at(unit) != computer) {
        throw std::invalid_argument("a move has the unit " + std::to_string(unit));
      }
      seen[unit] = 1;
    }
    return units;
  }

  // A placement of all units or of none.
  Placement complete(nb::handle from) {
    Placement placed = numbers<std::int32_t>(from, "placement");
    if (placed.empty()) return placed;
    check(placed, 0);
    return placed;
  }
  Placement partial(nb::handle from) {
    Placement placed = numbers<std::int32_t>(from, "placement");
    check(placed, -1);
    return placed;
  }
  void check(const Placement& placed, int lowest) {
    if (placed.size() != static_cast<std::size_t>(problem_.n)) {
      throw std::invalid_argument("placement has " + std::to_string(placed.size()) +
                                  " entries, must have " + std::to_string(problem_.n));
    }
    for (const std::int32_t computer : placed) {
      if (computer < lowest || computer >= problem_.m) {
        throw std::invalid_argument("placement has the computer " +
                                    std::to_string(computer));
      }
    }
  }

  Problem problem_;
  Greedy greedy_;
  Computers computers_;
  std::mutex exact_mutex_;
  std::unique_ptr<Exact> exact_;
  Placement placed_;
};

}  // namespace

NB_MODULE(_core, module) {
  module.doc() = "The placement engine in C++; see poise.plan.engine.";
  nb::class_<Core>(module, "Core", "A problem in flat tables, compiled once.")
      .def(
          "__init__",
          [](Core* self, std::int64_t n, std::int64_t m, std::int64_t r, nb::handle demand,
             nb::handle capacity, nb::handle limit, nb::handle size,
             nb::handle restricted, nb::handle offsets, nb::handle allowed,
             nb::handle first, nb::handle second, nb::handle overhead, nb::handle traffic,
             nb::handle distance, nb::handle cost, nb::handle bandwidth,
             nb::handle apart_first, nb::handle apart_second, double communication,
             nb::handle spread, bool share, bool variance) {
            Input in;
            in.n = n;
            in.m = m;
            in.r = r;
            in.demand = numbers<double>(demand, "demand");
            in.capacity = numbers<double>(capacity, "capacity");
            in.limit = numbers<double>(limit, "limit");
            in.size = numbers<double>(size, "size");
            in.restricted = numbers<std::int32_t>(restricted, "restricted");
            in.offsets = numbers<std::int32_t>(offsets, "offsets");
            in.allowed = numbers<std::int32_t>(allowed, "allowed");
            in.first = numbers<std::int32_t>(first, "first");
            in.second = numbers<std::int32_t>(second, "second");
            in.overhead = numbers<double>(overhead, "overhead");
            in.traffic = numbers<double>(traffic, "traffic");
            in.distance = numbers<double>(distance, "distance");
            in.cost = numbers<double>(cost, "cost");
            in.bandwidth = numbers<double>(bandwidth, "bandwidth");
            in.apart_first = numbers<std::int32_t>(apart_first, "apart_first");
            in.apart_second = numbers<std::int32_t>(apart_second, "apart_second");
            in.communication = communication;
            in.spread = numbers<double>(spread, "spread");
            in.share = share;
            in.variance = variance;
            new (self) Core(std::move(in));
          },
          nb::arg("n"), nb::arg("m"), nb::arg("r"), nb::arg("demand"),
          nb::arg("capacity"), nb::arg("limit"), nb::arg("size"), nb::arg("restricted"),
          nb::arg("offsets"), nb::arg("allowed"), nb::arg("first"), nb::arg("second"),
          nb::arg("overhead"), nb::arg("traffic"), nb::arg("distance"), nb::arg("cost"),
          nb::arg("bandwidth"), nb::arg("apart_first"), nb::arg("apart_second"),
          nb::arg("communication"), nb::arg("spread"), nb::arg("share"),
          nb::arg("variance"))
      .def("greedy", &Core::greedy)
      .def("rehearse", &Core::rehearse, nb::arg("times"))
      .def("exact", &Core::exact, nb::arg("known"), nb::arg("seconds"), nb::arg("steps"),
           nb::arg("stop").none() = nb::none())
      .def("search", &Core::search, nb::arg("known"), nb::arg("seconds"),
           nb::arg("steps"), nb::arg("seed"), nb::arg("stop").none() = nb::none(),
           nb::arg("thread_time") = false)
      .def("walk", &Core::walk, nb::arg("placed"), nb::arg("moves"))
      .def("multilevel", &Core::multilevel, nb::arg("seed"))
      .def("terms", &Core::terms, nb::arg("placed"))
      .def("feasible", &Core::feasible_, nb::arg("placed"))
      .def("bound", &Core::bound)
      .def_prop_ro("provable", &Core::provable)
      .def_prop_ro("bytes", &Core::bytes);
}
