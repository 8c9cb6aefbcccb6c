#include "direct_call.h"

#include <utility>

#include "deadline.h"

namespace nb = nanobind;

namespace poise {
namespace {

// `_of` is what is inside the object of that name.
struct DirectCall {
  nb::object method, exclusion, counts, translate, resend;
  Exclusion& exclusion_of;
  Counts& counts_of;
  double limit;  // [s]
};

void set_too_late(const DirectCall& call, double elapsed, double limit) {
  nb::object name = nb::getattr(call.method, "__qualname__", nb::str("the callee"));
  nb::object error = nb::module_::import_("poise.errors").attr("Timeout");
  nb::str text = nb::str("{} took {:.3f} s, limit {:.3g} s").format(name, elapsed, limit);
  PyErr_SetObject(error.ptr(), text.ptr());
}

void count_failed(Counts& counts, double elapsed) {
  counts.totals().calls.add(1);
  counts.totals().errors.add(1);
  counts.delay.add(elapsed);
}

PyObject* refuse(const DirectCall& call, Entry entry, Moment began, double limit,
                 PyObject* const* args, std::size_t num, PyObject* names) {
  if (entry == Entry::redirected && !call.resend.is_none())
    return PyObject_Vectorcall(call.resend.ptr(), args, num, names);
  if (entry == Entry::timeout)
    count_failed(call.counts_of, 1e-9 * static_cast<double>(wall_now() - began));
  set_entry_error(call.exclusion_of.what(), entry, limit, "was busy for");
  return nullptr;
}

PyObject* invoke(PyObject* self, PyObject* const* args, Py_ssize_t count, PyObject* names) {
  const DirectCall& call = *nb::inst_ptr<DirectCall>(self);
  const auto num = static_cast<std::size_t>(count);
  Counts& counts = call.counts_of;
  const Moment began = wall_now();
  const double limit = time_left(call.limit, began);
  if (limit <= 0.0) {
    count_failed(counts, 0.0);
    set_over(call.exclusion_of.what());
    return nullptr;
  }
  const Entry entry = call.exclusion_of.enter(current_chain(), limit);
  if (entry > Entry::late) return refuse(call, entry, began, limit, args, num, names);
  const Moment inside = entry == Entry::late ? wall_now() : began;

  // the proxy may let go of this object while the callee runs
  const nb::object held = nb::borrow(self);
  const bool measured = counts.totals().cpu.should_measure(inside);
  const std::int64_t cpu_began = measured ? cpu_now() : 0;
  const bool is_outermost = counts.totals().running.begin();
  PyObject* result;
  {
    const Deadline deadline(moment_after(began, limit));
    result = PyObject_Vectorcall(call.method.ptr(), args, num, names);
  }
  const std::int64_t cpu = measured ? cpu_now() - cpu_began : 0;
  call.exclusion_of.leave();

  const Moment ended = wall_now();
  ConnectorTotals& totals = counts.totals();  // by now it may be elsewhere than before
  if (is_outermost) totals.running.end();
  if (measured)
    totals.cpu.add_measured(inside, ended - inside, cpu);
  else
    totals.cpu.add(ended - inside);
  const double elapsed = 1e-9 * static_cast<double>(ended - began);
  totals.calls.add(1);
  counts.delay.add(elapsed);
  if (!result) {
    totals.errors.add(1);
    translate_error(call.translate);
  } else if (elapsed > limit) {
    totals.errors.add(1);
    Py_CLEAR(result);
    set_too_late(call, elapsed, limit);
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

nb::object direct_call(nb::object method, nb::handle_t<Exclusion> exclusion, double limit,
                       nb::handle_t<Counts> counts, nb::object translate, nb::object resend) {
  static PyMethodDef definition{
      "direct_call", reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(invoke)),
      METH_FASTCALL | METH_KEYWORDS, nullptr};
  const nb::object call = nb::cast(
      new DirectCall{std::move(method), nb::borrow(exclusion), nb::borrow(counts),
                     std::move(translate), std::move(resend), *nb::inst_ptr<Exclusion>(exclusion),
                     *nb::inst_ptr<Counts>(counts), limit},
      nb::rv_policy::take_ownership);
  return nb::steal(PyCFunction_New(&definition, call.ptr()));
}

void bind_direct_call(nb::module_& module) {
  nb::class_<DirectCall>(module, "DirectCall", nb::type_slots(slots),
                         "What a function that `direct_call` returned holds.");
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

void set_over(const std::string& what) {
  nb::object error = nb::module_::import_("poise.errors").attr("Timeout");
  nb::str text = nb::str("component '{}' was not called: no time is left").format(what.c_str());
  PyErr_SetObject(error.ptr(), text.ptr());
}

}  // namespace poise
