#include "served_call.h"

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
      raise_timeout(nb::str("an earlier call of the same caller ran {:g} s").format(limit));
  }
  ~Visiting() { visit_->give(); }
  Visiting(const Visiting&) = delete;
  Visiting& operator=(const Visiting&) = delete;

 private:
  std::shared_ptr<Visit> visit_;
};

// Keeps other chains out of the component for as long as it lives.
class Inside {
 public:
  Inside(Turn& turn, Chain chain, double limit) : turn_(turn) {
    const Entry entry = turn.enter(chain, limit);
    if (entry <= Entry::late) return;
    set_entry_error(turn.what(), static_cast<int>(entry), limit, "was busy for");
    throw nb::python_error();
  }
  ~Inside() { turn_.leave(); }
  Inside(const Inside&) = delete;
  Inside& operator=(const Inside&) = delete;

 private:
  Turn& turn_;
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
};

const Fields& fields() {
  static const Fields all;
  return all;
}

}  // namespace

ServedCall::ServedCall(nb::object decode, nb::object method, nb::object encode, nb::object turn,
                       double limit, nb::object counts, nb::object translate)
    : decode_(std::move(decode)),
      method_(std::move(method)),
      encode_(std::move(encode)),
      turn_(std::move(turn)),
      counts_(std::move(counts)),
      translate_(std::move(translate)),
      turn_of_(inside_of<Turn>(turn_, "a ServedCall takes a Turn")),
      counts_of_(inside_of<Counts>(counts_, "a ServedCall takes a Counts")),
      limit_(limit) {}

nb::object ServedCall::answer(nb::handle frame) {
  const std::int64_t began = wall_now();
  const bool measured = counts_of_.tally().cpu.should_measure_served(began);
  const std::int64_t cpu_began = measured ? cpu_now() : 0;

  const nb::object values = decode_(frame.attr(fields().body), frame.attr(fields().buffers));
  const auto chain = nb::cast<Chain>(frame.attr(fields().chain));
  nb::object pieces;
  {
    const Visiting visiting(chain, limit_);
    thread_chain = chain;
    const Inside inside(turn_of_, chain, limit_);
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
                        "after {:g} s")
                    .format(what, limit),
                error);
}

}  // namespace poise
