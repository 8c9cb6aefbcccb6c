#include "direct_call.h"

#include <cstdio>
#include <cstring>
#include <utility>

#include "deadline.h"
#include "poise/calls_api.hpp"

namespace nb = nanobind;

namespace poise {
namespace {

// `_of` is what is inside the object of that name.
struct DirectCall {
  nb::object method, exclusion, counts, translate, resend;
  Exclusion& exclusion_of;
  Counts& counts_of;
  double limit;  // [s]
  std::string name;
};

template <typename... Values>
Begin refuse(RunningDirectCall& run, const char* format, Values... values) {
  std::snprintf(run.refusal, sizeof run.refusal, format, values...);
  return Begin::refused;
}

// Under `calls_mutex`.
void count_failed(Counts& counts, double elapsed) {
  counts.totals().calls.add(1);
  counts.totals().errors.add(1);
  counts.delay.add(elapsed);
}

// `Entry::interrupted` leaves a Python error, and only then the GIL is held.
Begin refuse_entry(DirectCall& call, RunningDirectCall& run, Entry entry) {
  if (entry == Entry::redirected) return Begin::redirected;
  if (entry == Entry::interrupted) return Begin::refused;
  count_failed(call.counts_of, 1e-9 * static_cast<double>(wall_now() - run.began));
  return refuse(run, "component '%.100s' was busy for %.3g s", call.exclusion_of.what().c_str(),
                run.limit);
}

Begin begin_call(void* self, RunningDirectCall& run) {
  DirectCall& call = *static_cast<DirectCall*>(self);
  Counts& counts = call.counts_of;
  run.began = wall_now();
  run.limit = time_left(call.limit, run.began);
  CallsLock lock(calls_mutex);
  if (run.limit <= 0.0) {
    count_failed(counts, 0.0);
    return refuse(run, "component '%.100s' was not called: no time is left",
                  call.exclusion_of.what().c_str());
  }
  const Entry entry = call.exclusion_of.enter(lock, current_chain(), run.limit);
  if (entry > Entry::late) return refuse_entry(call, run, entry);
  run.inside = entry == Entry::late ? wall_now() : run.began;
  run.measured = counts.totals().cpu.should_measure(run.inside);
  run.is_outermost = counts.totals().running.begin();
  lock.unlock();
  run.cpu_began = run.measured ? cpu_now() : 0;
  run.deadline_before = thread_deadline;
  thread_deadline = std::min(thread_deadline, moment_after(run.began, run.limit));
  return Begin::entered;
}

bool end_call(void* self, RunningDirectCall& run, bool failed) {
  DirectCall& call = *static_cast<DirectCall*>(self);
  thread_deadline = run.deadline_before;
  const std::int64_t cpu = run.measured ? cpu_now() - run.cpu_began : 0;
  const CallsLock lock(calls_mutex);
  call.exclusion_of.leave();
  const Moment ended = wall_now();
  ConnectorTotals& totals = call.counts_of.totals();  // by now it may be elsewhere than before
  if (run.is_outermost) totals.running.end();
  if (run.measured)
    totals.cpu.add_measured(run.inside, ended - run.inside, cpu);
  else
    totals.cpu.add(ended - run.inside);
  const double elapsed = 1e-9 * static_cast<double>(ended - run.began);
  const bool late = elapsed > run.limit;
  totals.calls.add(1);
  totals.errors.add(failed || late);
  call.counts_of.delay.add(elapsed);
  if (late) refuse(run, "%.100s took %.3f s, limit %.3g s", call.name.c_str(), elapsed, run.limit);
  return !late;
}

void set_timeout(const char* text) {
  // names are cut short, perhaps within a letter
  const auto said = nb::steal(PyUnicode_DecodeUTF8(text, std::strlen(text), "ignore"));
  PyErr_SetObject(nb::module_::import_("poise.errors").attr("Timeout").ptr(), said.ptr());
}

PyObject* invoke(PyObject* self, PyObject* const* args, Py_ssize_t count, PyObject* names) {
  DirectCall& call = *nb::inst_ptr<DirectCall>(self);
  const auto num = static_cast<std::size_t>(count);
  RunningDirectCall run;
  const Begin begun = begin_call(&call, run);
  if (begun == Begin::redirected) {
    if (!call.resend.is_none()) return PyObject_Vectorcall(call.resend.ptr(), args, num, names);
    set_entry_error(call.exclusion_of.what(), Entry::redirected, run.limit, "");
  } else if (begun == Begin::refused && !PyErr_Occurred()) {
    set_timeout(run.refusal);
  }
  if (begun != Begin::entered) return nullptr;

  // the proxy may let go of this object while the callee runs
  const nb::object held = nb::borrow(self);
  PyObject* result = nullptr;
  {
    const Called called(call.exclusion_of);
    result = PyObject_Vectorcall(call.method.ptr(), args, num, names);
  }
  const bool in_time = end_call(&call, run, !result);
  if (!result) {
    translate_error(call.translate);
  } else if (!in_time) {
    Py_CLEAR(result);
    set_timeout(run.refusal);
  }
  return result;
}

int traverse(PyObject* self, visitproc visit, void* arg) {
  Py_VISIT(Py_TYPE(self));
  if (!nb::inst_ready(self)) return 0;
  const DirectCall& call = *nb::inst_ptr<DirectCall>(self);
  for (const nb::object* held :
       {&call.method, &call.exclusion, &call.counts, &call.translate, &call.resend})
    Py_VISIT(held->ptr());
  return 0;
}

// Break the cycle component -> proxy -> this -> method -> component.
int clear(PyObject* self) {
  DirectCall& call = *nb::inst_ptr<DirectCall>(self);
  call.method = call.resend = nb::none();
  return 0;
}

PyType_Slot slots[] = {
    {Py_tp_traverse, reinterpret_cast<void*>(traverse)},
    {Py_tp_clear, reinterpret_cast<void*>(clear)},
    {0, nullptr},
};

}  // namespace

void translate_error(nb::handle translate) {
  if (PyErr_ExceptionMatches(PyExc_KeyboardInterrupt)) return;
  PyObject *type, *value, *trace;
  PyErr_Fetch(&type, &value, &trace);
  PyErr_NormalizeException(&type, &value, &trace);
  if (trace) PyException_SetTraceback(value, trace);
  Py_XDECREF(PyObject_Vectorcall(translate.ptr(), &value, 1, nullptr));  // always raises
  Py_XDECREF(type);
  Py_XDECREF(value);
  Py_XDECREF(trace);
}

nb::object direct_call(nb::object method, nb::handle_t<Exclusion> exclusion, double limit,
                       nb::handle_t<Counts> counts, nb::object translate, nb::object resend) {
  static PyMethodDef definition{
      "direct_call", reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(invoke)),
      METH_FASTCALL | METH_KEYWORDS, nullptr};
  const auto name = nb::str(nb::getattr(method, "__qualname__", nb::str("the callee")));
  const nb::object call = nb::cast(
      new DirectCall{std::move(method), nb::borrow(exclusion), nb::borrow(counts),
                     std::move(translate), std::move(resend), *nb::inst_ptr<Exclusion>(exclusion),
                     *nb::inst_ptr<Counts>(counts), limit, name.c_str()},
      nb::rv_policy::take_ownership);
  return nb::steal(PyCFunction_New(&definition, call.ptr()));
}

static void* find_call(PyObject* function) {
  if (!PyCFunction_Check(function)) return nullptr;
  const nb::handle call = PyCFunction_GetSelf(function);
  return call.is_valid() && nb::isinstance<DirectCall>(call) ? nb::inst_ptr<DirectCall>(call)
                                                             : nullptr;
}

static PyObject* method_of(void* call) { return static_cast<DirectCall*>(call)->method.ptr(); }

void bind_direct_call(nb::module_& module) {
  nb::class_<DirectCall>(module, "DirectCall", nb::type_slots(slots),
                         "What a function that `direct_call` returned holds.");
  module.def("native_api", [] {
    static CallsApi api{find_call, method_of, begin_call, end_call};
    return nb::capsule(&api, calls_api_name);
  }, nb::sig("def native_api() -> object"));
}

void set_entry_error(const std::string& what, Entry entry, double limit, const char* action) {
  if (entry == Entry::interrupted) return;  // already set
  if (entry == Entry::redirected) {
    nb::object error = nb::module_::import_("poise.runtime.execution.exclusion").attr("Redirected");
    PyErr_Format(error.ptr(), "component '%s' has moved away", what.c_str());
    return;
  }
  nb::object error = nb::module_::import_("poise.errors").attr("Timeout");
  nb::str text = nb::str("component '{}' {} {:.3g} s").format(what.c_str(), action, limit);
  PyErr_SetObject(error.ptr(), text.ptr());
}

}  // namespace poise
