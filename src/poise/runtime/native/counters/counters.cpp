#include "counters.h"

#include "kernel_counters.h"

namespace poise {

void ComponentCounters::begin() {
  slot_->jobs.is_process.set(0);
  slot_->jobs.thread.set(this_thread());
}

void ComponentCounters::watch(int process) {
  command_ = std::make_unique<ProcessTree>("/proc", process);
  slot_->jobs.is_process.set(1);
  slot_->jobs.thread.set(process);
}

void ComponentCounters::end() {
  slot_->jobs.cpu.set(slot_->jobs.is_process.get() ? 0 : cpu_now());
  slot_->jobs.thread.set(0);
}

void ComponentCounters::note_idle() {
  if (slot_->jobs.is_process.get()) return;
  slot_->jobs.cpu.set(cpu_now());
  slot_->jobs.is_idle.set(1);
}

double ComponentCounters::cpu() {
  const Jobs& jobs = slot_->jobs;
  const std::int32_t thread = jobs.thread.get();
  std::int64_t used = 0;
  const bool is_read = thread && (jobs.is_process.get() ? command_->read(used)
                                                        : read_cpu(thread_cpu_clock(thread), used));
  return 1e-9 * static_cast<double>(is_read ? used : jobs.cpu.get());
}

void ComponentCounters::plan(const std::vector<std::pair<double, double>>& timers) {
  const double now = 1e-9 * static_cast<double>(wall_now());
  std::uint64_t asked = 0;
  for (const auto& timer : timers_) asked += timer_releases(**timer, now);
  timers_.clear();
  slot_->jobs.asked.add(asked);
  for (const auto& [start, period] : timers) {
    timers_.push_back(std::make_unique<Slot>());
    (*timers_.back())->start.set(start);
    (*timers_.back())->period.set(period);
  }
  if (slot_.page()) enter_timers();
}

bool ComponentCounters::enter(const std::shared_ptr<StatsPage>& page, const std::string& name,
                    std::uint32_t epoch) {
  if (!slot_.enter(page, Kind::component, name, epoch)) return false;
  enter_timers();
  return true;
}

void ComponentCounters::enter_timers() {
  for (const auto& timer : timers_) {
    (*timer)->target.set(slot_.id());
    timer->enter(slot_.page(), Kind::timer, "", 0);
  }
}

void ComponentCounters::leave() {
  for (const auto& timer : timers_) timer->leave();
  slot_.leave();
}

}  // namespace poise
