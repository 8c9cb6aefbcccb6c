// What Python sees; `make stubs` writes src/poise/simulation/_engine.pyi from it. Callables of
// Python are notices: they are called by `notify` and never while events happen.
#include <nanobind/nanobind.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include "elementary.h"
#include "engine.h"

namespace nb = nanobind;
using namespace nb::literals;
using namespace poise::simulation;

namespace {

#define NOTICE "collections.abc.Callable[[], object]"

using Names = std::vector<std::string>;
using Rates = std::vector<std::pair<std::string, double>>;  // by slot
using ComponentName = std::pair<std::string, int>;
using Handlers = std::map<std::string, Handler>;
using TimerRecord = std::tuple<std::string, double, std::optional<double>, Handler>;
using PortRecord = std::pair<Names, std::size_t>;
using ChainRecord = std::tuple<std::string, bool, std::optional<double>>;

constexpr auto inside = nb::rv_policy::reference_internal;

Action notice(nb::object callable) {
  return [callable = std::move(callable)] { callable(); };
}

// What happens as an event, and calls Python by a notice.
Action event(Events& events, nb::object callable) {
  return [&events, callable = std::move(callable)] { events.tell(notice(callable)); };
}

nb::object status_record(const char* name) {
  return nb::module_::import_("poise.wire.records.status_records").attr(name);
}

nb::object summary(const poise::Histogram& values) {
  return status_record("Summary")(values.count(), values.mean(), values.quantile(0.5),
                                  values.quantile(0.99), values.maximum());
}

nb::tuple timers_status(Executor& executor, double now) {
  nb::list found;
  for (const Timer& timer : executor.timers().all()) {
    const double until = executor.timers().until(now);
    found.append(status_record("TimerStatus")(
        "name"_a = timer.name(), "period"_a = timer.period(), "deadline"_a = timer.deadline(),
        "releases"_a = timer.releases(until), "missed"_a = timer.missed(until),
        "lateness"_a = summary(timer.lateness()), "duration"_a = summary(timer.duration())));
  }
  return nb::tuple(found);
}

nb::tuple chains_status(Executor& executor) {
  nb::list found;
  for (const ChainAge& chain : executor.ages().all())
    if (!chain.is_first)
      found.append(status_record("ChainStatus")(
          "name"_a = executor.container().engine().name(chain.chain),
          "deadline"_a = chain.deadline, "missed"_a = chain.missed,
          "age"_a = summary(chain.ages)));
  return nb::tuple(found);
}

double run(Engine& engine, double limit) {
  try {
    return engine.events.run(limit);
  } catch (const NoTimePasses& error) {
    const char* name = "poise.simulation.scheduler";
    PyErr_SetString(nb::module_::import_(name).attr("SimulationError").ptr(), error.what());
    throw nb::python_error();
  }
}

std::vector<Output> outputs(Engine& engine, const Rates& rates) {
  std::vector<Output> found;
  for (const auto& [slot, rate] : rates) found.push_back({&engine.ledger.slot(slot), rate});
  return found;
}

std::unordered_map<Slot*, Handler> by_slot(Engine& engine, const Handlers& handlers) {
  std::unordered_map<Slot*, Handler> found;
  for (const auto& [slot, handler] : handlers) found.emplace(&engine.ledger.slot(slot), handler);
  return found;
}

std::vector<ChainId> numbers(Engine& engine, const Names& names) {
  std::vector<ChainId> found;
  for (const std::string& name : names) found.push_back(engine.number(name));
  return found;
}

ComponentKey key_of(Engine& engine, const ComponentName& component) {
  return {engine.number(component.first), component.second};
}

Handler make_handler(Engine& engine, double work, double spread,
                     const std::optional<Rates>& publishes, const Rates& calls, double waiting,
                     double wait, double wait_spread, const Rates& joined,
                     const Rates& started) {
  Handler handler{work, spread, waiting, wait, wait_spread, {}, outputs(engine, calls),
                  outputs(engine, joined), outputs(engine, started)};
  if (publishes) handler.publishes = outputs(engine, *publishes);
  return handler;
}

const Model& make_model(Engine& engine, const std::vector<TimerRecord>& timers,
                        const Handlers& takes, const Handlers& serves, const Handler& other,
                        std::vector<double> factors, const std::vector<PortRecord>& keep,
                        std::size_t keep_other, double release_offset,
                        const std::optional<Handler>& answer) {
  Model model{{}, by_slot(engine, takes), by_slot(engine, serves), other, answer,
              std::move(factors), {}, keep_other, release_offset};
  for (const auto& [name, period, deadline, handler] : timers)
    model.timers.push_back({name, period, deadline, handler});
  for (const auto& [slots, room] : keep)
    for (const std::string& slot : slots)
      model.keep[&engine.ledger.slot(slot)] = {&engine.ledger.slot(slots.front()), room};
  return engine.models.emplace_back(std::move(model));
}

const Connector& make_connector(Engine& engine, const std::string& name, const std::string& key,
                                const std::string& slot, const ComponentName& source,
                                const ComponentName& target, const std::string& computer,
                                bool is_direct, double limit, double size,
                                std::pair<double, double> costs, const Names& carries,
                                const Names& answers) {
  return engine.connectors.emplace_back(
      Connector{name, key, engine.number(name), engine.number(key), &engine.ledger.slot(slot),
                key_of(engine, source), key_of(engine, target), engine.number(computer), is_direct,
                limit, size, costs.first, costs.second, numbers(engine, carries),
                numbers(engine, answers)});
}

Executor& add_component(Container& container, const ComponentName& component, std::int64_t process,
                        const Model& model, const std::vector<ChainRecord>& chains) {
  Engine& engine = container.engine();
  DataAges ages;
  for (const auto& [name, is_first, deadline] : chains)
    ages.add(engine.number(name), is_first, deadline);
  Incarnation& who = engine.ledger.incarnation(component.first, component.second,
                                               engine.name(container.computer()), process);
  return container.add(key_of(engine, component), who, model, std::move(ages));
}

void bind_cpu(nb::module_& module) {
  module.def("shares", [](double cores, const std::vector<std::pair<double, double>>& claims) {
    std::vector<CpuClaim> found;
    for (const auto& [weight, most] : claims) found.push_back({weight, most});
    return shares(cores, found);
  }, "cores"_a, "claims"_a);

  nb::class_<CpuGroup>(module, "CpuGroup", "The threads of a container or a program (cpu.h).")
      .def("run", [](CpuGroup& group, double work) { group.run(work, nullptr); }, "work"_a)
      .def("pause", &CpuGroup::pause, nb::kw_only(), "is_paused"_a = true)
      .def("end", &CpuGroup::end)
      .def_prop_rw("weight", &CpuGroup::weight, &CpuGroup::set_weight)
      .def_prop_ro("used", &CpuGroup::used)
      .def_prop_ro("throttled", &CpuGroup::throttled);

  nb::class_<Cpu>(module, "Cpu", "The cores of a computer (cpu.h).")
      .def("group", &Cpu::group, "weight"_a = 100.0, "most"_a = 1.0,
           "quota"_a = std::numeric_limits<double>::infinity(), inside)
      .def_prop_ro("cores", &Cpu::cores)
      .def_prop_ro("speed", &Cpu::speed)
      .def("used", &Cpu::used);
}

void bind_ledger(nb::module_& module) {
  nb::class_<Ledger>(module, "Ledger", "What components really did (ledger.h).")
      .def("commit", &Ledger::commit, "component"_a, "epoch"_a)
      .def("violate", &Ledger::violate, "invariant"_a, "what"_a)
      .def_prop_ro("violations", &Ledger::violations)
      .def_rw("is_whole", &Ledger::is_whole)
      .def_ro("handled", &Ledger::handled)
      .def_ro("processed", &Ledger::processed)
      .def_ro("dropped", &Ledger::dropped)
      .def_ro("calls", &Ledger::calls)
      .def_ro("failed_calls", &Ledger::failed_calls);
}

void bind_connectors(nb::module_& module) {
  nb::class_<Connector>(module, "Connector", "A connector of a deployment (model.h).")
      .def_ro("name", &Connector::name)
      .def_ro("key", &Connector::key);

  nb::class_<Stream>(module, "Stream", "One direction of a connection (links.h).")
      .def("send", [](Stream& stream, double size, nb::object deliver) {
        stream.send(size, event(stream.events(), std::move(deliver)));
      }, "size"_a, "deliver"_a, nb::sig("def send(self, size: float, deliver: " NOTICE ") -> None"))
      .def("close", &Stream::close)
      .def_prop_ro("is_closed", &Stream::is_closed)
      .def_prop_ro("is_cut", &Stream::is_cut);

  nb::class_<Sender>(module, "Sender", "The sending end of a connector (sender.h).")
      .def_prop_ro("connector", &Sender::connector, inside)
      .def_prop_ro("is_buffering", &Sender::is_buffering)
      .def_prop_ro("calls", &Sender::calls)
      .def_prop_ro("messages", &Sender::messages)
      .def_prop_ro("drops", &Sender::drops)
      .def("mark", &Sender::mark, "migration"_a)
      .def("buffer", &Sender::buffer)
      .def("redirect", &Sender::redirect, "connector"_a);
}

void bind_components(nb::module_& module) {
  nb::class_<Handler>(module, "Handler", "What one run of a handler costs and does (model.h).");
  nb::class_<Model>(module, "Model", "What a component does (model.h).");
  nb::class_<ExecutorState>(module, "ExecutorState", "What moves beside the snapshot (executor.h).");

  nb::class_<Executor>(module, "Executor", "Runs the handlers of an incarnation (executor.h).")
      .def_prop_ro("is_busy", &Executor::is_busy)
      .def_prop_ro("is_working", &Executor::is_working)
      .def_prop_ro("cpu", &Executor::cpu)
      .def_prop_ro("asked", &Executor::asked)
      .def_prop_ro("done", &Executor::done)
      .def("activate", &Executor::activate)
      .def("deactivate", &Executor::deactivate)
      .def("set_wanted", &Executor::set_wanted, "is_wanted"_a)
      .def("set_idle", &Executor::set_idle, "is_idle"_a)
      .def("set_leased", &Executor::set_leased, "is_leased"_a)
      .def("pause", &Executor::pause)
      .def("resume", &Executor::resume)
      .def("work", &Executor::work)
      .def("when_idle", [](Executor& executor, nb::object act) {
        executor.when_idle(notice(std::move(act)));
      }, "notice"_a, nb::sig("def when_idle(self, notice: " NOTICE ") -> None"))
      .def("hand_over", &Executor::hand_over)
      .def("take_back", &Executor::take_back, "state"_a)
      .def("restore", &Executor::restore, "state"_a)
      .def("marker", [](Executor& executor, const std::string& connector) {
        return executor.marker(executor.container().engine().number(connector));
      }, "connector"_a)
      .def("timers", &timers_status, "now"_a,
           nb::sig("def timers(self, now: float) -> tuple[poise.wire.records.status_records.TimerStatus, ...]"))
      .def("chains", &chains_status,
           nb::sig("def chains(self) -> tuple[poise.wire.records.status_records.ChainStatus, ...]"));

  nb::class_<Container>(module, "Container", "A process that runs components (container.h).")
      .def_prop_ro("cpu", &Container::group, inside)
      .def_prop_ro("computer", [](Container& container) {
        return container.engine().name(container.computer());
      })
      .def("pause", &Container::pause, "is_paused"_a)
      .def("end", &Container::end)
      .def("set_lease_end", &Container::set_lease_end, "end"_a)
      .def("may_work", &Container::may_work, "is_leased"_a)
      .def("add", &add_component, "component"_a, "process"_a, "model"_a, "chains"_a, inside)
      .def("remove", &Container::remove, "executor"_a)
      .def("connect", &Container::connect, "connectors"_a)
      .def("add_sender", &Container::add_sender, "connector"_a, inside)
      .def("remove_sender", &Container::remove_sender, "sender"_a)
      .def("senders_of", [](Container& container, const ComponentName& component) {
        return container.senders_of(key_of(container.engine(), component));
      }, "component"_a, inside)
      .def("await_progress", &Container::await_progress)
      .def("await_missed", &Container::await_missed);
}

void bind_engine(nb::module_& module) {
  nb::class_<Engine>(module, "Engine", "What happens often in a simulated robot (engine.h).")
      .def(nb::init<std::uint64_t, std::vector<double>>(), "seed"_a, "recorded"_a = nb::tuple())
      .def_prop_ro("now", [](Engine& engine) { return engine.events.now(); })
      .def("next", [](Engine& engine) { return engine.events.next(); })
      .def("run", &run, "limit"_a)
      .def("notify", [](Engine& engine) { return engine.events.notify(); })
      .def("end", &Engine::end)
      .def("draws", [](Engine& engine) { return engine.draws.made(); })
      .def_prop_ro("ledger", [](Engine& engine) -> Ledger& { return engine.ledger; }, inside)
      .def("set_link", [](Engine& engine, const std::string& source, const std::string& target,
                          double latency, double jitter, double bandwidth) {
        engine.links.set(engine.number(source), engine.number(target), {latency, jitter, bandwidth});
      }, "source"_a, "target"_a, "latency"_a, "jitter"_a, "bandwidth"_a)
      .def("set_usual_link", [](Engine& engine, double latency, double jitter, double bandwidth) {
        engine.links.set_usual({latency, jitter, bandwidth});
      }, "latency"_a, "jitter"_a, "bandwidth"_a)
      .def("is_cut", [](Engine& engine, const std::string& source, const std::string& target) {
        return engine.links.is_cut(engine.number(source), engine.number(target));
      }, "source"_a, "target"_a)
      .def("cut", [](Engine& engine, const std::string& source, const std::string& target) {
        engine.links.cut(engine.number(source), engine.number(target));
      }, "source"_a, "target"_a)
      .def("heal", [](Engine& engine, const std::string& source, const std::string& target) {
        engine.links.heal(engine.number(source), engine.number(target));
      }, "source"_a, "target"_a)
      .def("clog", [](Engine& engine, const std::string& source, const std::string& target,
                      double seconds) {
        engine.links.clog(engine.number(source), engine.number(target), seconds);
      }, "source"_a, "target"_a, "seconds"_a)
      .def("arrival", [](Engine& engine, const std::string& source, const std::string& target,
                         double size) {
        return engine.links.arrival(engine.number(source), engine.number(target), size);
      }, "source"_a, "target"_a, "size"_a)
      .def("time_for", [](Engine& engine, const std::string& source, const std::string& target,
                          double size) {
        return engine.links.time_for(engine.number(source), engine.number(target), size);
      }, "source"_a, "target"_a, "size"_a)
      .def("stream", [](Engine& engine, const std::string& source, const std::string& target)
                         -> Stream& {
        return engine.links.stream(engine.number(source), engine.number(target));
      }, "source"_a, "target"_a, inside)
      .def("cpu", [](Engine& engine, double cores, double speed, bool is_emulated) -> Cpu& {
        return engine.cpus.emplace_back(engine.events, cores, speed, is_emulated);
      }, "cores"_a, "speed"_a = 1.0, nb::kw_only(), "is_emulated"_a = false, inside)
      .def("handler", &make_handler, "work"_a, "spread"_a = 0.0,
           "publishes"_a.none() = nb::tuple(), "calls"_a = nb::tuple(), nb::kw_only(),
           "waiting"_a = 0.0, "wait"_a = 0.0, "wait_spread"_a = 0.0, "joined"_a = nb::tuple(),
           "started"_a = nb::tuple())
      .def("model", &make_model, "timers"_a, "takes"_a, "serves"_a, "other"_a, "factors"_a,
           "keep"_a, "keep_other"_a, "release_offset"_a = 0.0, "answer"_a.none() = nb::none(), inside)
      .def("connector", &make_connector, nb::kw_only(), "name"_a, "key"_a, "slot"_a, "source"_a,
           "target"_a, "computer"_a, "is_direct"_a, "limit"_a, "size"_a, "costs"_a, "carries"_a,
           "answers"_a, inside)
      .def("container", [](Engine& engine, Cpu& cpu, const std::string& computer,
                           nb::object on_progress, nb::object on_missed) -> Container& {
        return engine.containers.emplace_back(engine, cpu, engine.number(computer),
                                              notice(std::move(on_progress)),
                                              notice(std::move(on_missed)));
      }, "cpu"_a, "computer"_a, "on_progress"_a, "on_missed"_a, inside,
           nb::sig("def container(self, cpu: Cpu, computer: str, on_progress: " NOTICE
                   ", on_missed: " NOTICE ") -> Container"));
}

}  // namespace

NB_MODULE(_engine, module) {
  nb::set_leak_warnings(false);
  module.def("exponential", &exponential, "x"_a);
  module.def("logarithm", &logarithm, "x"_a);
  module.def("normal_quantile", &normal_quantile, "p"_a);
  bind_cpu(module);
  bind_ledger(module);
  bind_connectors(module);
  bind_components(module);
  bind_engine(module);
}
