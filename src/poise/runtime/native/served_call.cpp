#include "served_call.h"

#include "deadline.h"
#include "visit.h"

namespace nb = nanobind;

namespace poise {
namespace {

// `cause`, if any, is stolen.
[[noreturn]] void raise_timeout(const nb::object& text, PyObject* cause = nullptr) {
  const nb::object error = nb::module_::import_("poise.errors").attr("Timeout")(text);
  PyException_SetCause(error.ptr(), cause);
  PyErr_SetObject(error.type().ptr(), error.ptr());
  throw nb::python_error();
}

// Keeps other threads out of the chain for as long as it lives.
class Visiting {
 public:
  Visiting(Chain chain, double limit) : visit_(visit_of(chain)) {
    const Entry entry = visit_->take(limit);
    if (entry == Entry::interrupted) throw nb::python_error();
    if (entry > Entry::late)
      raise_timeout(nb::str("an earlier call of the same caller ran {:.3g} s").format(limit));
    waited_ = entry == Entry::late;
  }
  ~Visiting() { visit_->give(); }
  bool waited() const { return waited_; }
  Visiting(const Visiting&) = delete;
  Visiting& operator=(const Visiting&) = delete;

 private:
  std::shared_ptr<Visit> visit_;
  bool waited_ = false;
};

// Keeps other chains out of the component for as long as it lives.
class Inside {
 public:
  Inside(Turn& turn, Chain chain, double limit) : turn_(turn) {
    const Entry entry = turn.enter(chain, limit);
    waited_ = entry == Entry::late;
    if (entry <= Entry::late) return;
    set_entry_error(turn.what(), static_cast<int>(entry), limit, "was busy for");
    throw nb::python_error();
  }
  ~Inside() { turn_.leave(); }
  bool waited() const { return waited_; }
  Inside(const Inside&) = delete;
  Inside& operator=(const Inside&) = delete;

 private:
  Turn& turn_;
  bool waited_ = false;
};

template <class Bound>
Bound& inside_of(const nb::object& object, const char* what) {
  Bound* found = nullptr;
  if (!nb::try_cast(object, found) || !found) throw nb::type_error(what);
  return *found;
}

// The names of a frame's fields; never given back.
struct Fields {
  PyObject* body = PyUnicode_InternFromString("body");
  PyObject* buffers = PyUnicode_InternFromString("buffers");
  PyObject* chain = PyUnicode_InternFromString("chain");
  PyObject* number = PyUnicode_InternFromString("number");
};

const Fields& fields() {
  static const Fields all;
  return all;
}

}  // namespace

ServedCall::ServedCall(nb::object decode, nb::object method, nb::object encode, nb::object turn,
                       double limit, nb::object counts, nb::object translate,
                       nb::object is_over)
    : decode_(std::move(decode)),
      method_(std::move(method)),
      encode_(std::move(encode)),
      turn_(std::move(turn)),
      counts_(std::move(counts)),
      translate_(std::move(translate)),
      is_over_(std::move(is_over)),
      turn_of_(inside_of<Turn>(turn_, "a ServedCall takes a Turn")),
      counts_of_(inside_of<Counts>(counts_, "a ServedCall takes a Counts")),
      limit_(limit) {}

nb::object ServedCall::answer(nb::handle frame) {
  const Moment began = wall_now();
  const bool measured = counts_of_.tally().cpu.should_measure_served(began);
  const std::int64_t cpu_began = measured ? cpu_now() : 0;

  const nb::object values = decode_(frame.attr(fields().body), frame.attr(fields().buffers));
  const auto chain = nb::cast<Chain>(frame.attr(fields().chain));
  const double limit = limit_of(frame);
  nb::object pieces;
  {
    const Visiting visiting(chain, limit);
    thread_chain = chain;
    const Inside inside(turn_of_, chain, limit);
    const bool waited = visiting.waited() || inside.waited();
    if (waited && nb::cast<bool>(is_over_()))
      raise_timeout(nb::str("component '{}' was not called: its caller is gone")
                        .format(turn_of_.what().c_str()));
    const Deadline deadline(began, limit);
    pieces = run(values);
  }

  CpuShare& cpu = counts_of_.tally().cpu;  // by now it may be elsewhere than before
  const std::int64_t wall = wall_now() - began;
  if (measured)
    cpu.add_measured(began, wall, cpu_now() - cpu_began);
  else
    cpu.add(wall);
  if (!pieces.is_valid()) raise_callee_error();
  return pieces;
}

// What is left of the caller's time, at most this end's own limit.
double ServedCall::limit_of(nb::handle frame) const {
  const auto waits = nb::cast<std::uint64_t>(frame.attr(fields().number));
  return waits ? std::min(limit_, 1e-9 * static_cast<double>(waits)) : limit_;
}

// None, and Python's error set, when the callee raised. The result is encoded inside its
// turn: it may be part of its state.
nb::object ServedCall::run(nb::handle values) {
  const auto result = nb::steal(PyObject_CallObject(method_.ptr(), values.ptr()));
  if (!result.is_valid()) return nb::object();
  return nb::steal(PyObject_CallOneArg(encode_.ptr(), result.ptr()));
}

void ServedCall::raise_callee_error() {
  translate_error(translate_);
  throw nb::python_error();
}

nb::object away(Chain chain, double limit, const char* what, nb::handle request,
                nb::handle pieces) {
  Away outside(chain);
  const nb::float_ seconds(limit);
  PyObject* arguments[] = {pieces.ptr(), seconds.ptr()};
  const auto answer = nb::steal(PyObject_Vectorcall(request.ptr(), arguments, 2, nullptr));
  PyObject *type, *error, *trace;
  PyErr_Fetch(&type, &error, &trace);
  if (type) PyErr_NormalizeException(&type, &error, &trace);
  // who was called back runs a component that waits here
  const Entry entry = outside.come_back(limit);
  if (entry <= Entry::late) {
    PyErr_Restore(type, error, trace);
    if (!answer.is_valid()) throw nb::python_error();
    return answer;
  }
  Py_XDECREF(trace);
  Py_XDECREF(type);
  if (entry == Entry::interrupted) {
    Py_XDECREF(error);
    throw nb::python_error();
  }
  raise_timeout(nb::str("connector {}: the call is over, but a call back from it still runs "
                        "after {:.3g} s")
                    .format(what, limit),
                error);
}

}  // namespace poise
