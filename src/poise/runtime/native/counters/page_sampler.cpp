#include "page_sampler.h"

#include "cpu_share.h"

namespace nb = nanobind;

namespace poise {

static constexpr double look_every = 1.0;   // [s]
static constexpr double usual_rest = 0.01;  // what Poise uses itself [cores]

nb::object PageSampler::read() {
  std::int64_t used = 0;
  learn();
  look_for_threads();
  if (!tree_.read(used)) return nb::none();
  const double now = 1e-9 * static_cast<double>(wall_now());
  attribute(now);
  const double cpu = 1e-9 * static_cast<double>(used);
  read_at_ = now;
  rest_ = cpu;
  nb::list components, connectors;
  for (std::size_t i = 0; i < known_.size(); ++i) {
    const std::uint64_t id = known_[i].id;
    if (!id) continue;
    const Kind kind = memory_[i].kind.get();
    if (kind != Kind::component && kind != Kind::connector) continue;
    if (!known_[i].has_name) continue;  // calls from outside: over no connector
    nb::tuple sample =
        kind == Kind::component ? component_sample(i) : connector_sample(i);
    // a record that was reused meanwhile counts from the next sample on
    if (memory_.is_still(i, id))
      (kind == Kind::component ? components : connectors).append(sample);
  }
  if (components.size() == 0) return nb::none();
  return nb::make_tuple(now, cpu, components, connectors);
}

// Look whose threads they are when the process uses more than its components and Poise do.
void PageSampler::look_for_threads() {
  if (!looked_at_) looked_at_ = read_at_;
  const double since = read_at_ - looked_at_;
  if (since < look_every || rest_ - looked_rest_ < usual_rest * since) return;
  looked_at_ = read_at_;
  looked_rest_ = rest_;
  std::vector<int> threads;
  for (std::size_t i = 0; i < known_.size(); ++i) {
    const Record& record = memory_[i];
    if (!known_[i].id || record.kind.get() != Kind::component) continue;
    const int thread = record.jobs.thread.get();
    if (thread && !record.jobs.is_process.get()) threads.push_back(thread);
  }
  own_threads_.look(threads);
}

// Take note of records that came or went.
void PageSampler::learn() {
  known_.resize(memory_.used());
  for (std::size_t i = 0; i < known_.size(); ++i) {
    Known& known = known_[i];
    const Record& record = memory_[i];
    const std::uint64_t id = record.id.get();
    if (id == known.id) continue;
    known = Known{};
    const std::string text = record.name.get();
    nb::object name = nb::steal(PyUnicode_DecodeUTF8(
        text.data(), static_cast<Py_ssize_t>(text.size()), "replace"));
    if (!name.is_valid()) throw nb::python_error();
    known.name = std::move(name);
    known.has_name = !text.empty();
    known.id = memory_.is_still(i, id) ? id : 0;
  }
}

PageSampler::Known* PageSampler::component(std::uint64_t id) {
  const Record* record = memory_.find(id);
  if (!record || record->kind.get() != Kind::component) return nullptr;
  const auto index = static_cast<std::size_t>(record - &memory_[0]);
  return index < known_.size() && known_[index].id == id ? &known_[index] : nullptr;
}

// Find whose CPU time it was: a call runs on its caller's thread, for its callee. A
// connector counts its calls' CPU time with all that they called in turn, also while
// they run, so a component's own is that of its thread, plus the calls into it, less those out of it.
// Calls from other containers run on threads of their transport: nobody else loses.
void PageSampler::attribute(double now) {
  for (Known& known : known_) {
    known.called = 0.0;
    known.served = known.asked = 0;
  }
  for (std::size_t i = 0; i < known_.size(); ++i) {
    if (!known_[i].id) continue;
    const Record& record = memory_[i];
    const Kind kind = record.kind.get();
    if (kind != Kind::timer && kind != Kind::connector) continue;
    Known* target = component(record.target.get());
    if (!target) continue;
    if (kind == Kind::timer) {
      target->asked += timer_releases(record, now);
      continue;
    }
    const double cpu = called_over(i);
    const std::uint64_t calls = record.totals.calls.get();
    Known* source = component(record.source.get());
    if (!memory_.is_still(i, known_[i].id)) continue;
    target->called += cpu;
    target->served += calls;
    if (source) source->called -= cpu;
  }
}

// The CPU time of all calls over a connector [s].
double PageSampler::called_over(std::size_t index) {
  const ConnectorTotals& totals = memory_[index].totals;
  const double running = running_over(index), ended = totals.cpu.seconds();
  // one that ended meanwhile may be in both
  const bool still_runs = totals.running.thread() && totals.running.number() == known_[index].call;
  return still_runs ? ended + running : totals.cpu.seconds();
}

// The CPU time of the call that runs over a connector [s], since it was first seen.
double PageSampler::running_over(std::size_t index) {
  const RunningCall& running = memory_[index].totals.running;
  Known& known = known_[index];
  const std::uint64_t number = running.number();
  const int thread = running.thread();
  if (!thread) return 0.0;
  if (!known.thread || known.thread->thread() != thread)
    known.thread = std::make_unique<ThreadCounters>(proc_, thread);
  if (!known.thread->read()) return 0.0;
  if (known.call != number) {
    known.call = number;
    known.began = known.thread->cpu;
  }
  return 1e-9 * static_cast<double>(known.thread->cpu - known.began);
}

nb::tuple PageSampler::component_sample(std::size_t index) {
  const Jobs& jobs = memory_[index].jobs;
  Known& known = known_[index];
  const int thread = jobs.thread.get();
  const bool is_idle = jobs.is_idle.get();
  std::int64_t used = jobs.cpu.get();
  if (thread && !is_idle) {
    if (!known.thread || known.thread->thread() != thread)
      known.thread = std::make_unique<ThreadCounters>(proc_, thread);
    if (known.thread->read()) used = known.thread->cpu;
    if (jobs.is_process.get()) read_command(known, thread, used);
  }
  if (thread && !jobs.is_process.get())
    known.own = own_threads_.cpu(thread) + tree_.started_by(thread);
  std::uint64_t asked = known.asked + jobs.asked.get(), done = jobs.done.get();
  if (!asked) asked = done = known.served;
  const double cpu = 1e-9 * static_cast<double>(used + known.own) + known.called;
  rest_ -= cpu;
  // jobs tell better whether it keeps up, and the kernel was not asked every time
  const bool has_wait = known.thread && !asked;
  const double wait = has_wait ? 1e-9 * static_cast<double>(known.thread->wait) : 0.0;
  return nb::make_tuple(known.name, memory_[index].epoch.get(), cpu, wait, asked, done);
}

// What a command started belongs to it, as a script does little itself.
void PageSampler::read_command(Known& known, int process, std::int64_t& used) {
  if (!known.command || known.command->root() != process) {
    known.command = std::make_unique<ProcessTree>(proc_, process);
    known.command->look_closely();
  }
  known.command->read(used);
}

nb::tuple PageSampler::connector_sample(std::size_t index) const {
  const ConnectorTotals& totals = memory_[index].totals;
  return nb::make_tuple(known_[index].name, totals.calls.get(), totals.messages.get(),
                        totals.bytes_out.get(), totals.bytes_in.get(), totals.errors.get(),
                        totals.drops.get(), totals.arrivals.get(),
                        1e-9 * static_cast<double>(totals.latency.get()),
                        1e-9 * static_cast<double>(totals.latency_error.get()));
}

}  // namespace poise
