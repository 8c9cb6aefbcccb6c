// One thread at a time runs a call chain in a process.
//
// A chain comes into a process by a call over a pipe, or begins here. When its first
// thread waits for an answer from elsewhere, a second may come in with the same chain: it
// was called back. But when a caller gave up, the first thread goes on, or still runs:
// whoever comes then must wait, or two threads would be in one component.
#pragma once

#include <memory>
#include <string>

#include "turn.h"

namespace poise {

// A chain that is in this process, for as long as somebody keeps this.
class Visit {
 public:
  explicit Visit(Chain chain);
  ~Visit();
  Visit(const Visit&) = delete;
  Visit& operator=(const Visit&) = delete;

  // Become the one that runs, within `limit` [s].
  Entry take(double limit);
  // Let another thread run.
  void give();

 private:
  friend class Away;

  Chain chain_;
  unsigned long holder_ = 0;  // the thread that runs; 0: none
  Turn baton_;
};

// The visit of a chain that comes in; under the GIL, as all of this.
std::shared_ptr<Visit> visit_of(Chain chain);

// Lets a chain come back on another thread, while this one waits elsewhere.
class Away {
 public:
  explicit Away(Chain chain);

  // Go on, once nobody runs it who was called back; within `limit` [s].
  Entry come_back(double limit) { return visit_ ? visit_->take(limit) : Entry::entered; }

 private:
  std::shared_ptr<Visit> visit_;  // none: another thread runs the chain
};

}  // namespace poise
