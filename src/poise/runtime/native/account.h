// What a component used and did.
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "ledger.h"

namespace poise {

class Account {
 public:
  // Count the CPU time of this thread, or of all threads of a process, from now on.
  void begin();
  void watch(int process);
  // Count no more; of the thread that began, and only there, the time so far stays.
  void end();

  // The thread begins to wait for work: its CPU time stays as it is. And it goes on.
  void note_idle();
  void note_busy() { entered_->jobs.is_idle.set(0); }

  void note_asked() { entered_->jobs.asked.add(1); }
  void note_done() { entered_->jobs.done.add(1); }

  // Let these timers ask for jobs, and no others: their starts and periods [s].
  void plan(const std::vector<std::pair<double, double>>& timers);

  double cpu() const;  // [s]

  // As for `Entered`; in a ledger that is full, timers may stay outside.
  bool enter(const std::shared_ptr<Ledger>& ledger, const std::string& name,
             std::uint32_t epoch);
  void leave();

  std::uint64_t id() const { return entered_.id(); }

 private:
  void enter_timers();

  Entered entered_;
  std::vector<std::unique_ptr<Entered>> timers_;
};

}  // namespace poise
