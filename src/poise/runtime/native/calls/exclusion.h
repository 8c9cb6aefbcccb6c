// Mutual exclusion of call chains in a component: ROS 2's mutually exclusive callback group,
// with re-entrance. tests/runtime/reference.py is the same in Python, and tests compare both.
//
// One lock of the process, `calls_mutex`, guards all exclusions and what is counted of calls, for
// components in C++ enter without Python's GIL. Whoever holds it waits for nothing. A thread that
// waits releases it, and the GIL if it has that, and sleeps on a semaphore of its own; a thread
// that leaves hands the exclusion to the one that has waited longest.
#pragma once

#include <deque>
#include <mutex>
#include <string>

#include "chain.h"

namespace poise {

inline std::mutex calls_mutex;
using CallsLock = std::unique_lock<std::mutex>;

enum class Entry {
  entered,
  late,  // entered, after a wait
  timeout,
  redirected,
  interrupted,  // a Python signal handler raised
};

// Hold `calls_mutex` for every method; one that may wait takes the lock, to release it meanwhile.
class Exclusion {
 public:
  explicit Exclusion(std::string what) : what_(std::move(what)) {}
  Exclusion(const Exclusion&) = delete;
  Exclusion& operator=(const Exclusion&) = delete;

  const std::string& what() const { return what_; }
  bool is_redirected() const { return redirected_; }

  // Wait up to `limit` [s] until no other chain is inside.
  Entry enter(CallsLock& lock, Chain chain, double limit) {
    if (chain == owner_ && chain != no_chain) {
      ++depth_;
      return Entry::entered;
    }
    return acquire(lock, chain, limit);
  }

  // Undo one `enter`; false when nobody is inside.
  bool leave() {
    if (depth_ > 0) {
      --depth_;
      return true;
    }
    return release();
  }

  // Let others in while `chain`, which is inside, waits in a call of its own. Returns what
  // `step_in` needs, or -1 when there is nothing to step out of.
  int step_out(Chain chain) {
    if (chain != owner_ || chain == no_chain || lent_) return -1;
    const int depth = depth_;
    depth_ = 0;
    ++outside_;
    release();
    return depth;
  }

  // Wait up to `limit` [s] to be inside again, redirected or not.
  Entry step_in(CallsLock& lock, Chain chain, int depth, double limit);

  // Wait up to `limit` [s] until no chain is inside or has stepped out, and let none in.
  Entry pause(CallsLock& lock, double limit) { return acquire(lock, no_chain, limit); }

  // Let chains enter; false when it is not paused.
  bool resume() { return release(); }

  // Let one chain in while paused; no_chain ends that.
  void lend(Chain chain) {
    owner_ = chain;
    lent_ = chain != no_chain;
  }

  // Refuse all chains that wait, and all that come from now on.
  void redirect();

 private:
  struct Waiter;

  Entry acquire(CallsLock& lock, Chain chain, double limit) {
    if (redirected_) return Entry::redirected;
    if (held_ || !may_have(chain)) return wait(lock, chain, limit, false);
    held_ = true;
    owner_ = chain;
    return Entry::entered;
  }

  // A pause waits for chains that stepped out: they may wait for others, which may enter.
  bool may_have(Chain chain) const { return chain != no_chain || outside_ == 0; }

  bool release();
  Entry wait(CallsLock& lock, Chain chain, double limit, bool steps_in);

  std::string what_;
  std::deque<Waiter*> waiting_;
  Chain owner_ = no_chain;
  int depth_ = 0;
  int outside_ = 0;     // chains that stepped out
  bool lent_ = false;
  bool held_ = true;  // paused until it is first resumed
  bool redirected_ = false;
};

// That of the component in which this thread runs a call; none: it runs no call.
POISE_NEAR_THREAD_LOCAL const Exclusion* thread_called;

// Lets this thread run a call in a component, for as long as it lives.
class Called {
 public:
  explicit Called(const Exclusion& callee) : before_(thread_called) { thread_called = &callee; }
  ~Called() { thread_called = before_; }
  Called(const Called&) = delete;
  Called& operator=(const Called&) = delete;

 private:
  const Exclusion* before_;
};

}  // namespace poise
