#include "reader.h"

#include <cstring>

#include "cpu_share.h"

namespace nb = nanobind;

namespace poise {

nb::object Reader::read() {
  std::int64_t used = 0;
  learn();
  if (!read_cpu(process_cpu_clock(process_), used)) return nb::none();
  const double now = 1e-9 * static_cast<double>(wall_now());
  attribute(now);
  double cpu = 1e-9 * static_cast<double>(used);
  nb::list components, connectors;
  for (std::size_t i = 0; i < known_.size(); ++i) {
    if (!known_[i].id) continue;
    const Kind kind = pages_[i].kind.get();
    if (kind == Kind::component) components.append(component_sample(i, cpu));
    if (kind == Kind::connector) connectors.append(connector_sample(i));
  }
  if (components.size() == 0) return nb::none();
  return nb::make_tuple(now, cpu, components, connectors);
}

std::vector<int> Reader::commands() const {
  std::vector<int> found;
  for (std::size_t i = 0; i < pages_.used(); ++i) {
    const Line& line = pages_[i];
    if (!line.id.get() || line.kind.get() != Kind::component) continue;
    const int process = line.jobs.thread.get();
    if (line.jobs.is_process.get() && process) found.push_back(process);
  }
  return found;
}

// Take note of lines that came or went.
void Reader::learn() {
  known_.resize(pages_.used());
  for (std::size_t i = 0; i < known_.size(); ++i) {
    Known& known = known_[i];
    const Line& line = pages_[i];
    const std::uint64_t id = line.id.get();
    if (id == known.id) continue;
    known = Known{};
    const std::size_t length = strnlen(line.name, Line::longest_name);
    nb::object name = nb::steal(PyUnicode_DecodeUTF8(
        line.name, static_cast<Py_ssize_t>(length), "replace"));
    if (!name.is_valid()) throw nb::python_error();
    known.name = std::move(name);
    // while it was read, the line may have become another's
    known.id = line.id.get() == id ? id : 0;
  }
}

Reader::Known* Reader::component(std::uint64_t id) {
  const Line* line = pages_.find(id);
  if (!line || line->kind.get() != Kind::component) return nullptr;
  const auto index = static_cast<std::size_t>(line - &pages_[0]);
  return index < known_.size() && known_[index].id == id ? &known_[index] : nullptr;
}

// Find whose CPU time it was: a call runs on its caller's thread, for its callee. A
// connector counts its calls' CPU time with all that they called in turn, so a
// component's own is that of its thread, plus the calls into it, less those out of it.
// Calls from other containers run on threads of their transport: nobody else loses.
void Reader::attribute(double now) {
  for (Known& known : known_) {
    known.called = 0.0;
    known.served = known.asked = 0;
  }
  for (std::size_t i = 0; i < known_.size(); ++i) {
    if (!known_[i].id) continue;
    const Line& line = pages_[i];
    const Kind kind = line.kind.get();
    if (kind != Kind::timer && kind != Kind::connector) continue;
    Known* target = component(line.target.get());
    if (!target) continue;
    if (kind == Kind::timer) {
      target->asked += timer_releases(line, now);
      continue;
    }
    const double cpu = line.tally.cpu.seconds();
    target->called += cpu;
    target->served += line.tally.calls.get();
    if (Known* source = component(line.source.get())) source->called -= cpu;
  }
}

nb::tuple Reader::component_sample(std::size_t index, double& of_commands) {
  const Jobs& jobs = pages_[index].jobs;
  Known& known = known_[index];
  const int thread = jobs.thread.get();
  const bool is_idle = jobs.is_idle.get();
  std::int64_t used = jobs.cpu.get();
  if (thread && !is_idle) {
    if (!known.thread || known.thread->thread() != thread)
      known.thread = std::make_unique<ThreadCounters>(proc_, thread);
    if (known.thread->read()) used = known.thread->cpu;
    if (jobs.is_process.get() && read_cpu(process_cpu_clock(thread), used))
      of_commands += 1e-9 * static_cast<double>(used);
  }
  std::uint64_t asked = known.asked + jobs.asked.get(), done = jobs.done.get();
  if (!asked) asked = done = known.served;
  const double cpu = 1e-9 * static_cast<double>(used) + known.called;
  // jobs tell better whether it keeps up, and the kernel was not asked every time
  const bool has_wait = known.thread && !asked;
  const double wait = has_wait ? 1e-9 * static_cast<double>(known.thread->wait) : 0.0;
  return nb::make_tuple(known.name, pages_[index].epoch.get(), cpu, wait, asked, done);
}

nb::tuple Reader::connector_sample(std::size_t index) const {
  const Tally& tally = pages_[index].tally;
  return nb::make_tuple(known_[index].name, tally.calls.get(), tally.messages.get(),
                        tally.bytes_out.get(), tally.bytes_in.get(), tally.errors.get(),
                        tally.drops.get(), tally.arrivals.get(),
                        1e-9 * static_cast<double>(tally.latency.get()),
                        1e-9 * static_cast<double>(tally.latency_error.get()));
}

}  // namespace poise
