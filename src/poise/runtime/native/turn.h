// One call chain at a time in a component; tests/runtime/reference.py is the same in
// Python, and the tests compare the two.
//
// Everything here happens under Python's GIL, which is therefore the only lock. A
// thread that waits gives up the GIL and sleeps on a semaphore of its own; whoever
// leaves hands the turn to the one that waits longest.
#pragma once

#include <deque>
#include <string>

#include "chain.h"

namespace poise {

enum class Entry {
  entered,
  late,  // entered, after a wait
  timeout,
  retired,
  interrupted,  // a Python signal handler raised
};

class Turn {
 public:
  explicit Turn(std::string what) : what_(std::move(what)) {}
  Turn(const Turn&) = delete;
  Turn& operator=(const Turn&) = delete;

  const std::string& what() const { return what_; }
  bool is_retired() const { return retired_; }

  // Wait for the turn up to `limit` [s].
  Entry enter(Chain chain, double limit) {
    if (chain == owner_ && chain != no_chain) {
      ++depth_;
      return Entry::entered;
    }
    return acquire(chain, limit);
  }

  // Give the turn back; false when nobody had it.
  bool leave() {
    if (depth_ > 0) {
      --depth_;
      return true;
    }
    return release();
  }

  // Let others in while `chain`, which has the turn, waits in a call of its own. Returns
  // what `step_in` needs, or -1 when there is nothing to step out of.
  int step_out(Chain chain) {
    if (chain != owner_ || chain == no_chain || lent_) return -1;
    const int depth = depth_;
    depth_ = 0;
    ++outside_;
    release();
    return depth;
  }

  // Wait up to `limit` [s] for the turn again; retired or not, the chain must go on here.
  Entry step_in(Chain chain, int depth, double limit);

  // Wait up to `limit` [s] until no chain is inside or has stepped out, and let none in.
  Entry shut(double limit) { return acquire(no_chain, limit); }

  // Let chains enter; false when it is not shut.
  bool open() { return release(); }

  // Let one chain in while shut; no_chain ends that.
  void lend(Chain chain) {
    owner_ = chain;
    lent_ = chain != no_chain;
  }

  // Send away everyone who waits, and everyone who comes from now on.
  void retire();

 private:
  struct Waiter;

  Entry acquire(Chain chain, double limit) {
    if (retired_) return Entry::retired;
    if (held_ || !may_have(chain)) return wait(chain, limit, false);
    held_ = true;
    owner_ = chain;
    return Entry::entered;
  }

  // Whoever shuts waits for those that stepped out, and lets others in that these wait for.
  bool may_have(Chain chain) const { return chain != no_chain || outside_ == 0; }

  bool release();
  Entry wait(Chain chain, double limit, bool steps_in);

  std::string what_;
  std::deque<Waiter*> waiting_;
  Chain owner_ = no_chain;
  int depth_ = 0;
  int outside_ = 0;     // chains that stepped out
  bool lent_ = false;
  bool held_ = true;  // shut until it is first opened
  bool retired_ = false;
};

}  // namespace poise
