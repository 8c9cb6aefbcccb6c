#include "account.h"

#include <unistd.h>
#include <sys/syscall.h>

#include "kernel_counters.h"

namespace poise {

void Account::begin() {
  entered_->jobs.is_process.set(0);
  entered_->jobs.thread.set(static_cast<std::int32_t>(syscall(SYS_gettid)));
}

void Account::watch(int process) {
  entered_->jobs.is_process.set(1);
  entered_->jobs.thread.set(process);
}

void Account::end() {
  entered_->jobs.cpu.set(entered_->jobs.is_process.get() ? 0 : cpu_now());
  entered_->jobs.thread.set(0);
}

void Account::note_idle() {
  entered_->jobs.cpu.set(cpu_now());
  entered_->jobs.is_idle.set(1);
}

double Account::cpu() const {
  const Jobs& jobs = entered_->jobs;
  const std::int32_t thread = jobs.thread.get();
  std::int64_t used = 0;
  const auto clock = jobs.is_process.get() ? process_cpu_clock : thread_cpu_clock;
  if (!thread || !read_cpu(clock(thread), used)) used = jobs.cpu.get();
  return 1e-9 * static_cast<double>(used);
}

void Account::plan(const std::vector<std::pair<double, double>>& timers) {
  const double now = 1e-9 * static_cast<double>(wall_now());
  std::uint64_t asked = 0;
  for (const auto& timer : timers_) asked += timer_releases(**timer, now);
  timers_.clear();
  entered_->jobs.asked.add(asked);
  for (const auto& [start, period] : timers) {
    timers_.push_back(std::make_unique<Entered>());
    (*timers_.back())->start.set(start);
    (*timers_.back())->period.set(period);
  }
  if (entered_.ledger()) enter_timers();
}

bool Account::enter(const std::shared_ptr<Ledger>& ledger, const std::string& name,
                    std::uint32_t epoch) {
  if (!entered_.enter(ledger, Kind::component, name, epoch)) return false;
  enter_timers();
  return true;
}

void Account::enter_timers() {
  for (const auto& timer : timers_) {
    (*timer)->target.set(entered_.id());
    timer->enter(entered_.ledger(), Kind::timer, "", 0);
  }
}

void Account::leave() {
  for (const auto& timer : timers_) timer->leave();
  entered_.leave();
}

}  // namespace poise
