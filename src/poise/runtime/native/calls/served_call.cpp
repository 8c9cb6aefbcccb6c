#include "served_call.h"

#include "deadline.h"
#include "chain_lock.h"

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

double seconds_until(Moment until) {
  return 1e-9 * static_cast<double>(std::max<Moment>(0, until - wall_now()));
}

// Keeps other threads out of the chain for as long as it lives.
class ChainHold {
 public:
  ChainHold(Chain chain, Moment until) : lock_(chain_lock_of(chain)) {
    const double limit = seconds_until(until);
    const Entry entry = lock_->take(limit);
    if (entry == Entry::interrupted) throw nb::python_error();
    if (entry > Entry::late)
      raise_timeout(nb::str("an earlier call of the same caller ran {:.3g} s").format(limit));
    waited_ = entry == Entry::late;
  }
  ~ChainHold() { lock_->give(); }
  bool waited() const { return waited_; }
  ChainHold(const ChainHold&) = delete;
  ChainHold& operator=(const ChainHold&) = delete;

 private:
  std::shared_ptr<ChainLock> lock_;
  bool waited_ = false;
};

// Keeps other chains out of the component for as long as it lives.
class Inside {
 public:
  Inside(Exclusion& exclusion, Chain chain, Moment until) : exclusion_(exclusion) {
    const double limit = seconds_until(until);
    CallsLock lock(calls_mutex);
    const Entry entry = exclusion.enter(lock, chain, limit);
    lock.unlock();
    waited_ = entry == Entry::late;
    if (entry <= Entry::late) return;
    set_entry_error(exclusion.what(), entry, limit, "was busy for");
    throw nb::python_error();
  }
  ~Inside() {
    const CallsLock lock(calls_mutex);
    exclusion_.leave();
  }
  bool waited() const { return waited_; }
  Inside(const Inside&) = delete;
  Inside& operator=(const Inside&) = delete;

 private:
  Exclusion& exclusion_;
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
  PyObject* came = PyUnicode_InternFromString("came");
  PyObject* age = PyUnicode_InternFromString("age");
};

const Fields& fields() {
  static const Fields all;
  return all;
}

}  // namespace

ServedCall::ServedCall(nb::object decode, nb::object method, nb::object encode, nb::object exclusion,
                       double limit, nb::object counts, nb::object translate,
                       nb::object is_over, nb::object lease)
    : decode_(std::move(decode)),
      method_(std::move(method)),
      encode_(std::move(encode)),
      exclusion_(std::move(exclusion)),
      counts_(std::move(counts)),
      translate_(std::move(translate)),
      is_over_(std::move(is_over)),
      lease_(std::move(lease)),
      exclusion_of_(inside_of<Exclusion>(exclusion_, "a ServedCall takes an Exclusion")),
      counts_of_(inside_of<Counts>(counts_, "a ServedCall takes a Counts")),
      lease_of_(lease_.is_none() ? nullptr
                                 : &inside_of<LeaseEnd>(lease_, "a ServedCall takes a LeaseEnd")),
      limit_(limit) {}

nb::object ServedCall::answer(nb::handle frame, double ahead) {
  const Moment began = wall_now();
  const bool measured = counts_of_.totals().cpu.should_measure_served(began);
  const std::int64_t cpu_began = measured ? cpu_now() : 0;

  const Moment until = deadline_of(frame, ahead, began);
  refuse_late(until, began);
  const nb::object values = decode_(frame.attr(fields().body), frame.attr(fields().buffers));
  const auto chain = nb::cast<Chain>(frame.attr(fields().chain));
  nb::object pieces;
  bool is_outermost = false;
  {
    const ChainHold holding(chain, until);
    thread_chain = chain;
    const Inside inside(exclusion_of_, chain, until);
    refuse_late(until, wall_now());
    refuse_fenced();
    if ((holding.waited() || inside.waited()) && nb::cast<bool>(is_over_()))
      refuse(nb::str("its caller is gone"));
    const Deadline deadline(until);
    const Called called(exclusion_of_);
    is_outermost = counts_of_.totals().running.begin();
    pieces = run(values);
  }

  ConnectorTotals& totals = counts_of_.totals();  // by now it may be elsewhere than before
  if (is_outermost) totals.running.end();
  CpuShare& cpu = totals.cpu;
  const std::int64_t wall = wall_now() - began;
  if (measured)
    cpu.add_measured(began, wall, cpu_now() - cpu_began);
  else
    cpu.add(wall);
  if (!pieces.is_valid()) raise_callee_error();
  return pieces;
}

// When the caller's limit or this end's own passes. The caller's began when it sent the frame:
// the time on the wire counts.
Moment ServedCall::deadline_of(nb::handle frame, double ahead, Moment began) const {
  const Moment own = moment_after(began, limit_);
  const auto waits = nb::cast<std::uint64_t>(frame.attr(fields().number));
  if (waits == 0) return own;
  const double age = nb::cast<double>(frame.attr(fields().age)) + ahead;
  const double left = 1e-9 * static_cast<double>(waits) - (age > 0.0 ? age : 0.0);  // or NaN
  const auto came = static_cast<Moment>(1e9 * nb::cast<double>(frame.attr(fields().came)));
  return std::min(own, moment_after(came, std::max(left, -1e9)));
}

void ServedCall::refuse_late(Moment until, Moment now) const {
  if (now < until) return;
  const double late = 1e-9 * static_cast<double>(now - until);
  refuse(nb::str("its caller's limit passed {:.3g} s ago").format(late));
}

void ServedCall::refuse_fenced() const {
  if (!lease_of_ || !lease_of_->is_past()) return;
  const nb::object type = nb::module_::import_("poise.runtime.execution.container_lease").attr("LeaseEnded");
  const nb::object error = type(exclusion_of_.what().c_str());
  PyErr_SetObject(type.ptr(), error.ptr());
  throw nb::python_error();
}

void ServedCall::refuse(const nb::object& why) const {
  raise_timeout(
      nb::str("component '{}' was not called: {}").format(exclusion_of_.what().c_str(), why));
}

// None, and Python's error set, when the callee raised. The result is encoded inside the
// exclusion: it may be part of the component's state.
nb::object ServedCall::run(nb::handle values) {
  const auto result = nb::steal(PyObject_CallObject(method_.ptr(), values.ptr()));
  if (!result.is_valid()) return nb::object();
  PyObject* const arguments[] = {result.ptr()};
  return nb::steal(PyObject_Vectorcall(encode_.ptr(), arguments, 1, nullptr));
}

void ServedCall::raise_callee_error() {
  translate_error(translate_);
  throw nb::python_error();
}

nb::object call_remote(Chain chain, double limit, const char* what, nb::handle request,
                       nb::handle pieces) {
  const Moment until = moment_after(wall_now(), limit);
  ChainRelease released(chain);
  const nb::float_ seconds(limit);
  PyObject* arguments[] = {pieces.ptr(), seconds.ptr()};
  const auto answer = nb::steal(PyObject_Vectorcall(request.ptr(), arguments, 2, nullptr));
  PyObject *type, *error, *trace;
  PyErr_Fetch(&type, &error, &trace);
  if (type) PyErr_NormalizeException(&type, &error, &trace);
  // A call back that still runs is in a component that waits here. Its own limits end with this
  // one, and it leaves a moment later.
  const Entry entry = released.take_again(std::max(seconds_until(until), std::min(limit, 0.02)));
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
