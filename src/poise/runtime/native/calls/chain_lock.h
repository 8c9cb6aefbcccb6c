// One thread at a time runs a call chain in a process.
//
// A chain begins in a process, or comes into it by a call over a connection. While its thread
// waits for an answer from another container, a second thread may run the chain: that is a
// call back. After a caller gave up, the first thread may still run: then the second one must
// wait, or two threads would run in one component.
#pragma once

#include <memory>
#include <string>

#include "exclusion.h"

namespace poise {

// Held by the thread that runs a chain. It lives as long as somebody refers to it.
class ChainLock {
 public:
  explicit ChainLock(Chain chain);
  ~ChainLock();
  ChainLock(const ChainLock&) = delete;
  ChainLock& operator=(const ChainLock&) = delete;

  // Wait up to `limit` [s] to run the chain.
  Entry take(double limit);
  // Of a thread that gave it and did not get it again, this does nothing.
  void give();

 private:
  friend class ChainRelease;

  Chain chain_;
  unsigned long holder_ = 0;  // the thread that runs; 0: none
  Exclusion exclusion_;
};

// The lock of a chain that comes in; under the GIL, as everything here.
std::shared_ptr<ChainLock> chain_lock_of(Chain chain);

// Releases a chain while its thread waits for an answer from another container.
class ChainRelease {
 public:
  explicit ChainRelease(Chain chain);

  // Wait up to `limit` [s] until no call back runs, and go on.
  Entry take_again(double limit) { return lock_ ? lock_->take(limit) : Entry::entered; }

 private:
  std::shared_ptr<ChainLock> lock_;  // none: another thread runs the chain
};

}  // namespace poise
