// What a component used and did.
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "process_tree.h"
#include "stats_page.h"

namespace poise {

class ComponentCounters {
 public:
  // Count the CPU time of this thread, or of a process and all that it started, from now on.
  void begin();
  void watch(int process);
  // Count no more; of the thread that began, and only there, the time so far stays.
  void end();

  // The thread begins to wait for work: its CPU time stays as it is. And it goes on.
  void note_idle();
  void note_busy() { slot_->jobs.is_idle.set(0); }

  void note_asked() { slot_->jobs.asked.add(1); }
  void note_done() { slot_->jobs.done.add(1); }

  // Let these timers ask for jobs, and no others: their starts and periods [s].
  void plan(const std::vector<std::pair<double, double>>& timers);

  double cpu();  // [s]

  // As for `Slot`; in a full page, timers may stay outside.
  bool enter(const std::shared_ptr<StatsPage>& page, const std::string& name,
             std::uint32_t epoch);
  void leave();

  std::uint64_t id() const { return slot_.id(); }

 private:
  void enter_timers();

  Slot slot_;
  std::vector<std::unique_ptr<Slot>> timers_;
  std::unique_ptr<ProcessTree> command_;
};

}  // namespace poise
