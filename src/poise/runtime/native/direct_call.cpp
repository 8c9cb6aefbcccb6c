#include "direct_call.h"

#include <structmember.h>

#include <cstddef>

#include "deadline.h"
#include "exclusion.h"

namespace nb = nanobind;

namespace poise {
namespace {

struct DirectCall {
  PyObject_HEAD
  vectorcallfunc vectorcall;
  PyObject* method;
  PyObject* exclusion;
  PyObject* counts;
  PyObject* translate;  // raises what a caller gets when its callee raised
  PyObject* resend;     // takes a call whose callee has moved away; or None
  Exclusion* exclusion_of;        // inside `exclusion`
  Counts* counts_of;    // inside `counts`
  double limit;         // [s]
};

void set_too_late(const DirectCall* call, double elapsed, double limit) {
  nb::object name = nb::getattr(call->method, "__qualname__", nb::str("the callee"));
  nb::object error = nb::module_::import_("poise.errors").attr("Timeout");
  nb::str text = nb::str("{} took {:.3f} s, limit {:.3g} s").format(name, elapsed, limit);
  PyErr_SetObject(error.ptr(), text.ptr());
}

void count_failed(Counts& counts, double elapsed) {
  counts.totals().calls.add(1);
  counts.totals().errors.add(1);
  counts.delay.add(elapsed);
}

PyObject* refuse(DirectCall* call, Entry entry, Moment began, double limit, PyObject* const* args,
                 std::size_t num, PyObject* names) {
  if (entry == Entry::redirected && call->resend != Py_None)
    return PyObject_Vectorcall(call->resend, args, num, names);
  if (entry == Entry::timeout)
    count_failed(*call->counts_of, 1e-9 * static_cast<double>(wall_now() - began));
  set_entry_error(call->exclusion_of->what(), static_cast<int>(entry), limit, "was busy for");
  return nullptr;
}

PyObject* invoke(PyObject* self, PyObject* const* args, std::size_t num, PyObject* names) {
  auto* call = reinterpret_cast<DirectCall*>(self);
  Counts& counts = *call->counts_of;
  const Moment began = wall_now();
  const double limit = time_left(call->limit, began);
  if (limit <= 0.0) {
    count_failed(counts, 0.0);
    set_over(call->exclusion_of->what());
    return nullptr;
  }
  const Entry entry = call->exclusion_of->enter(current_chain(), limit);
  if (entry > Entry::late) return refuse(call, entry, began, limit, args, num, names);
  const Moment inside = entry == Entry::late ? wall_now() : began;

  // the facade may let go of this object while the callee runs
  Py_INCREF(self);
  const bool measured = counts.totals().cpu.should_measure(inside);
  const std::int64_t cpu_began = measured ? cpu_now() : 0;
  PyObject* result;
  {
    const Deadline deadline(moment_after(began, limit));
    result = PyObject_Vectorcall(call->method, args, num, names);
  }
  const std::int64_t cpu = measured ? cpu_now() - cpu_began : 0;
  call->exclusion_of->leave();

  const Moment ended = wall_now();
  ConnectorTotals& totals = counts.totals();  // by now it may be elsewhere than before
  if (measured)
    totals.cpu.add_measured(inside, ended - inside, cpu);
  else
    totals.cpu.add(ended - inside);
  const double elapsed = 1e-9 * static_cast<double>(ended - began);
  totals.calls.add(1);
  counts.delay.add(elapsed);
  if (!result) {
    totals.errors.add(1);
    translate_error(call->translate);
  } else if (elapsed > limit) {
    totals.errors.add(1);
    Py_CLEAR(result);
    set_too_late(call, elapsed, limit);
  }
  Py_DECREF(self);
  return result;
}

int traverse(PyObject* self, visitproc visit, void* arg) {
  auto* call = reinterpret_cast<DirectCall*>(self);
  Py_VISIT(Py_TYPE(self));
  Py_VISIT(call->method);
  Py_VISIT(call->exclusion);
  Py_VISIT(call->counts);
  Py_VISIT(call->translate);
  Py_VISIT(call->resend);
  return 0;
}

// Break the cycle component -> facade -> this -> method -> component.
int clear(PyObject* self) {
  auto* call = reinterpret_cast<DirectCall*>(self);
  Py_SETREF(call->method, Py_NewRef(Py_None));
  Py_SETREF(call->resend, Py_NewRef(Py_None));
  return 0;
}

void deallocate(PyObject* self) {
  PyTypeObject* type = Py_TYPE(self);
  PyObject_GC_UnTrack(self);
  auto* call = reinterpret_cast<DirectCall*>(self);
  Py_CLEAR(call->method);
  Py_CLEAR(call->resend);
  Py_CLEAR(call->exclusion);
  Py_CLEAR(call->counts);
  Py_CLEAR(call->translate);
  PyObject_GC_Del(self);
  Py_DECREF(type);
}

PyObject* create(PyTypeObject* type, PyObject* args, PyObject* keywords) {
  static const char* names[] = {"method", "exclusion", "limit", "counts", "translate", "resend", nullptr};
  PyObject *method, *exclusion, *counts, *translate, *resend = Py_None;
  double limit = 0.0;
  if (!PyArg_ParseTupleAndKeywords(args, keywords, "OOdOO|O", const_cast<char**>(names), &method,
                                   &exclusion, &limit, &counts, &translate, &resend))
    return nullptr;
  Exclusion* exclusion_of = nullptr;
  Counts* counts_of = nullptr;
  if (!nb::try_cast(nb::handle(exclusion), exclusion_of) || !nb::try_cast(nb::handle(counts), counts_of) ||
      !exclusion_of || !counts_of) {
    PyErr_SetString(PyExc_TypeError, "DirectCall takes an Exclusion and a Counts");
    return nullptr;
  }
  auto* call = PyObject_GC_New(DirectCall, type);
  if (!call) return nullptr;
  call->vectorcall = invoke;
  call->method = Py_NewRef(method);
  call->exclusion = Py_NewRef(exclusion);
  call->counts = Py_NewRef(counts);
  call->translate = Py_NewRef(translate);
  call->resend = Py_NewRef(resend);
  call->exclusion_of = exclusion_of;
  call->counts_of = counts_of;
  call->limit = limit;
  auto* self = reinterpret_cast<PyObject*>(call);
  PyObject_GC_Track(self);
  return self;
}

PyMemberDef members[] = {
    {"__vectorcalloffset__", T_PYSSIZET, offsetof(DirectCall, vectorcall), READONLY, nullptr},
    {"limit", T_DOUBLE, offsetof(DirectCall, limit), READONLY, nullptr},
    {nullptr, 0, 0, 0, nullptr},
};

PyType_Slot slots[] = {
    {Py_tp_new, reinterpret_cast<void*>(create)},
    {Py_tp_dealloc, reinterpret_cast<void*>(deallocate)},
    {Py_tp_traverse, reinterpret_cast<void*>(traverse)},
    {Py_tp_clear, reinterpret_cast<void*>(clear)},
    {Py_tp_call, reinterpret_cast<void*>(PyVectorcall_Call)},
    {Py_tp_members, members},
    {0, nullptr},
};

PyType_Spec spec = {
    "poise.runtime._calls.DirectCall",
    sizeof(DirectCall),
    0,
    Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC | Py_TPFLAGS_HAVE_VECTORCALL,
    slots,
};

}  // namespace

void translate_error(nb::handle translate) {
  if (!PyErr_ExceptionMatches(PyExc_Exception) && !PyErr_ExceptionMatches(PyExc_SystemExit)) return;
  PyObject *type, *value, *trace;
  PyErr_Fetch(&type, &value, &trace);
  PyErr_NormalizeException(&type, &value, &trace);
  if (trace) PyException_SetTraceback(value, trace);
  Py_XDECREF(PyObject_CallOneArg(translate.ptr(), value));  // always raises
  Py_XDECREF(type);
  Py_XDECREF(value);
  Py_XDECREF(trace);
}

nb::object make_direct_call_type() { return nb::steal(PyType_FromSpec(&spec)); }

void set_entry_error(const std::string& what, int entry, double limit, const char* action) {
  if (entry == static_cast<int>(Entry::interrupted)) return;  // already set
  if (entry == static_cast<int>(Entry::redirected)) {
    nb::object error = nb::module_::import_("poise.runtime.execution.exclusion").attr("Redirected");
    PyErr_Format(error.ptr(), "component '%s' has moved away", what.c_str());
    return;
  }
  nb::object error = nb::module_::import_("poise.errors").attr("Timeout");
  nb::str text = nb::str("component '{}' {} {:.3g} s").format(what.c_str(), action, limit);
  PyErr_SetObject(error.ptr(), text.ptr());
}

void set_over(const std::string& what) {
  nb::object error = nb::module_::import_("poise.errors").attr("Timeout");
  nb::str text = nb::str("component '{}' was not called: no time is left").format(what.c_str());
  PyErr_SetObject(error.ptr(), text.ptr());
}

}  // namespace poise
