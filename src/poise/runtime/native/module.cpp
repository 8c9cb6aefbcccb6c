// What Python sees; `make stubs` writes src/poise/runtime/_calls.pyi from it. Most of it relies on
// the GIL as its lock: every method is atomic, and those that wait give it up meanwhile. What calls
// of components in C++ use without the GIL is under `calls_mutex`.
#include <nanobind/nanobind.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <limits>

#include "counters/counters.h"
#include "counters/lease_end.h"
#include "calls/deadline.h"
#include "calls/direct_call.h"
#include "counters/page_sampler.h"
#include "calls/served_call.h"
#include "calls/exclusion.h"

namespace nb = nanobind;
using namespace poise;

constexpr double unknown = std::numeric_limits<double>::quiet_NaN();

#define CALLABLE "collections.abc.Callable"
#define ANY_CALLABLE CALLABLE "[..., typing.Any]"
#define TRANSLATE CALLABLE "[[BaseException], typing.NoReturn]"
#define PIECES "list[poise.wire.codec.Bytes]"
#define FRAME "poise.wire.frame.Frame"

static void check(const Exclusion& exclusion, Entry entry, double limit, const char* action) {
  if (entry == Entry::entered || entry == Entry::late) return;
  set_entry_error(exclusion.what(), entry, limit, action);
  throw nb::python_error();
}

template <typename Function>
static auto under_lock(Function function) {
  const CallsLock lock(calls_mutex);
  return function();
}

// The method of a class, under `calls_mutex`.
template <auto Method, typename Class, typename Result, typename... Values>
static auto locked_method(Result (Class::*)(Values...)) {
  return [](Class& object, Values... values) {
    return under_lock([&] { return (object.*Method)(values...); });
  };
}
template <auto Method, typename Class, typename Result, typename... Values>
static auto locked_method(Result (Class::*)(Values...) const) {
  return [](const Class& object, Values... values) {
    return under_lock([&] { return (object.*Method)(values...); });
  };
}
template <auto Method>
static auto locked() {
  return locked_method<Method>(Method);
}

static void require(bool was_held) {
  if (!was_held) throw std::runtime_error("nobody is inside");
}

template <auto Member>
static void def_number(nb::class_<Counts>& counts, const char* name) {
  counts.def_prop_rw(
      name, [](Counts& counts) { return under_lock([&] { return (counts.totals().*Member).get(); }); },
      [](Counts& counts, std::uint64_t value) {
        under_lock([&] { (counts.totals().*Member).set(value); });
      });
}

NB_MODULE(_calls, module) {
  nb::set_leak_warnings(false);  // containers end without finalising the interpreter

  module.def("begin_chains", &begin_chains, nb::arg("first"));
  module.def("new_chain", &new_chain);
  module.def("join_chain", [](Chain chain) { thread_chain = chain; }, nb::arg("chain"));
  module.def("current_chain", &current_chain);

  module.def("time_left", [](double limit) { return time_left(limit, wall_now()); },
             nb::arg("limit"));
  module.def("called", [] { return thread_called ? thread_called->what() : std::string(); },
             "Return the component that this thread calls into; empty: none.");
  module.def("deadline", [] { return thread_deadline; });
  module.def("set_deadline", [](Moment moment) { thread_deadline = moment; }, nb::arg("moment"));

  nb::class_<Exclusion>(module, "Exclusion", "Mutual exclusion of call chains in a component (exclusion.h).")
      .def(nb::init<std::string>(), nb::arg("what"))
      .def_prop_ro("is_redirected", locked<&Exclusion::is_redirected>())
      .def(
          "enter",
          [](Exclusion& exclusion, Chain chain, double limit) {
            CallsLock lock(calls_mutex);
            const Entry entry = exclusion.enter(lock, chain, limit);
            lock.unlock();
            check(exclusion, entry, limit, "was busy for");
          },
          nb::arg("chain"), nb::arg("limit"))
      .def("leave", [](Exclusion& exclusion) { require(under_lock([&] { return exclusion.leave(); })); })
      .def("step_out", locked<&Exclusion::step_out>(), nb::arg("chain"))
      .def(
          "step_in",
          [](Exclusion& exclusion, Chain chain, int depth, double limit) {
            CallsLock lock(calls_mutex);
            const Entry entry = exclusion.step_in(lock, chain, depth, limit);
            lock.unlock();
            check(exclusion, entry, limit, "was busy for");
          },
          nb::arg("chain"), nb::arg("depth"), nb::arg("limit"))
      .def("lend", locked<&Exclusion::lend>(), nb::arg("chain"))
      .def("resume", [](Exclusion& exclusion) { require(under_lock([&] { return exclusion.resume(); })); })
      .def(
          "pause",
          [](Exclusion& exclusion, double limit) {
            CallsLock lock(calls_mutex);
            const Entry entry = exclusion.pause(lock, limit);
            lock.unlock();
            check(exclusion, entry, limit, "did not pause within");
          },
          nb::arg("limit"))
      .def("redirect", locked<&Exclusion::redirect>());

  nb::class_<Histogram>(module, "Histogram", "Counts values, with quantiles right within 5 % (histogram.h).")
      .def(nb::init<>())
      .def("add", locked<&Histogram::add>(), nb::arg("value"))
      .def("quantile", locked<&Histogram::quantile>(), nb::arg("share"))
      .def_prop_ro("sum", locked<&Histogram::sum>())
      .def("summary", [](const Histogram& histogram) {
        CallsLock lock(calls_mutex);
        const auto count = histogram.count();
        const auto mean = histogram.mean(), median = histogram.quantile(0.5),
                   p99 = histogram.quantile(0.99), maximum = histogram.maximum();
        lock.unlock();
        return nb::module_::import_("poise.wire.records.status_records")
            .attr("Summary")(count, mean, median, p99, maximum);
      }, nb::sig("def summary(self) -> poise.wire.records.status_records.Summary"));

  nb::class_<StatsPage>(module, "StatsPage", "The container's end of its stats page (stats_page.h).")
      .def(nb::init<int>(), nb::arg("descriptor"))
      .def("beat", &StatsPage::beat);
  module.attr("RECORD_SIZE") = sizeof(Record);

  nb::class_<PageSampler>(module, "PageSampler", "The agent's end of a container's stats page (page_sampler.h).")
      .def(nb::init<int, int, std::string>(), nb::arg("descriptor"), nb::arg("process"),
           nb::arg("proc") = "/proc")
      .def("read", &PageSampler::read,
           nb::sig("def read(self) -> tuple[float, float, "
                   "list[tuple[str, int, float, float, int, int]], "
                   "list[tuple[str, int, int, int, int, int, int, int, float, float]]] | None"))
      .def("heartbeat", &PageSampler::heartbeat)
      .def("descendants", &PageSampler::descendants);

  nb::class_<ComponentCounters>(module, "ComponentCounters", "What a component used and did (counters.h).")
      .def(nb::init<>())
      .def("begin", &ComponentCounters::begin)
      .def("watch", &ComponentCounters::watch, nb::arg("process"))
      .def("end", &ComponentCounters::end)
      .def("note_idle", &ComponentCounters::note_idle)
      .def("note_busy", &ComponentCounters::note_busy)
      .def("note_asked", &ComponentCounters::note_asked)
      .def("note_done", &ComponentCounters::note_done)
      .def("plan", &ComponentCounters::plan, nb::arg("timers"))
      .def("cpu", &ComponentCounters::cpu)
      .def("enter", &ComponentCounters::enter, nb::arg("page"), nb::arg("name"), nb::arg("epoch"))
      .def("leave", &ComponentCounters::leave);

  auto counts = nb::class_<Counts>(module, "Counts", "What one end of a connector counts (direct_call.h).").def(nb::init<>());
  def_number<&ConnectorTotals::calls>(counts, "calls");
  def_number<&ConnectorTotals::messages>(counts, "messages");
  def_number<&ConnectorTotals::bytes_out>(counts, "bytes_out");
  def_number<&ConnectorTotals::bytes_in>(counts, "bytes_in");
  def_number<&ConnectorTotals::errors>(counts, "errors");
  def_number<&ConnectorTotals::drops>(counts, "drops");
  counts.def_ro("delay", &Counts::delay)
      .def_ro("wait", &Counts::wait)
      .def_ro("size", &Counts::size)
      .def_ro("latency", &Counts::latency)
      .def("add_call", locked<&Counts::add_call>(), nb::arg("seconds"), nb::arg("bytes_out") = 0,
           nb::arg("bytes_in") = 0, nb::arg("latency") = unknown, nb::arg("error") = 0.0,
           nb::arg("failed") = false)
      .def("add_message", locked<&Counts::add_message>(), nb::arg("bytes_out") = 0,
           nb::arg("bytes_in") = 0, nb::arg("latency") = unknown, nb::arg("error") = 0.0)
      .def_prop_ro("latency_error",
                   [](Counts& counts) {
                     const CallsLock lock(calls_mutex);
                     const auto num = static_cast<double>(counts.totals().arrivals.get());
                     const auto sum = static_cast<double>(counts.totals().latency_error.get());
                     return num > 0.0 ? 1e-9 * sum / num : 0.0;
                   })
      .def_prop_ro("cpu", [](Counts& counts) {
        return under_lock([&] { return counts.totals().cpu.seconds(); });
      })
      .def(
          "add_cpu",
          [](Counts& counts, double seconds) {
            const CallsLock lock(calls_mutex);
            const auto time = static_cast<std::int64_t>(1e9 * seconds);
            counts.totals().cpu.add_measured(wall_now(), time, time);
          },
          nb::arg("seconds"))
      .def(
          "enter",
          [](Counts& counts, std::shared_ptr<StatsPage> page, const std::string& name) {
            const CallsLock lock(calls_mutex);
            return counts.entered.enter(std::move(page), Kind::connector, name, 0);
          },
          nb::arg("page"), nb::arg("name"))
      .def(
          "attribute",
          [](Counts& counts, const ComponentCounters* source, const ComponentCounters* target) {
            const CallsLock lock(calls_mutex);
            counts.entered->source.set(source ? source->id() : 0);
            counts.entered->target.set(target ? target->id() : 0);
          },
          nb::arg("source").none(), nb::arg("target").none())
      .def("leave", [](Counts& counts) { under_lock([&] { counts.entered.leave(); }); });

  nb::class_<LeaseEnd>(module, "LeaseEnd", "Until when leased components may act (lease_end.h).")
      .def(nb::init<int>(), nb::arg("memory"))
      .def_prop_rw("at", &LeaseEnd::at, &LeaseEnd::set)
      .def("is_past", &LeaseEnd::is_past);

  nb::class_<ServedCall>(module, "ServedCall", "Answers the calls of one method (served_call.h).")
      .def(nb::init<nb::object, nb::object, nb::object, nb::object, double, nb::object,
                    nb::object, nb::object, nb::object>(),
           nb::arg("decode"), nb::arg("method"), nb::arg("encode"), nb::arg("exclusion"),
           nb::arg("limit"), nb::arg("counts"), nb::arg("translate"), nb::arg("is_over"),
           nb::arg("lease") = nb::none(),
           nb::sig("def __init__(self, decode: " CALLABLE
                   "[[poise.wire.codec.Bytes, memoryview], tuple[typing.Any, ...]], "
                   "method: " ANY_CALLABLE ", encode: " CALLABLE "[[typing.Any], " PIECES "], "
                   "exclusion: Exclusion, limit: float, counts: Counts, "
                   "translate: " TRANSLATE ", is_over: " CALLABLE "[[], bool], "
                   "lease: LeaseEnd | None = None) -> None"))
      .def("__call__", &ServedCall::answer, nb::arg("frame"), nb::arg("ahead") = 0.0,
           nb::sig("def __call__(self, frame: " FRAME ", ahead: float = 0.0) -> " PIECES));
  module.def("call_remote", &call_remote, nb::arg("chain"), nb::arg("limit"), nb::arg("what"),
             nb::arg("request"), nb::arg("pieces"),
             nb::sig("def call_remote(chain: int, limit: float, what: str, request: " CALLABLE
                     "[[" PIECES ", float], " FRAME "], pieces: " PIECES ") -> " FRAME));

  bind_direct_call(module);
  module.def("direct_call", &direct_call, nb::arg("method"), nb::arg("exclusion"),
             nb::arg("limit"), nb::arg("counts"), nb::arg("translate"),
             nb::arg("resend") = nb::none(),
             nb::sig("def direct_call(method: " ANY_CALLABLE ", exclusion: Exclusion, "
                     "limit: float, counts: Counts, translate: " TRANSLATE ", "
                     "resend: " ANY_CALLABLE " | None = None) -> " ANY_CALLABLE));
}
