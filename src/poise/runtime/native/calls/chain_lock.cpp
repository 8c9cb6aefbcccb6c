#include <Python.h>

#include "chain_lock.h"

#include <mutex>
#include <unordered_map>

namespace poise {
namespace {

// Threads that end release theirs without the GIL. Never destroyed: other threads may
// still run when the process ends.
struct ChainLocks {
  std::mutex changing;
  std::unordered_map<Chain, std::weak_ptr<ChainLock>> by_chain;
};

ChainLocks& chain_locks() {
  static auto* all = new ChainLocks();
  return *all;
}

// The last chain that began on this thread and called another container. The thread keeps
// its lock even when the chain is over: a call back may still come, late.
thread_local std::shared_ptr<ChainLock> begun;

std::shared_ptr<ChainLock> find(Chain chain) {
  const std::lock_guard<std::mutex> guard(chain_locks().changing);
  const auto place = chain_locks().by_chain.find(chain);
  return place == chain_locks().by_chain.end() ? nullptr : place->second.lock();
}

std::shared_ptr<ChainLock> begin(Chain chain) {
  auto lock = std::make_shared<ChainLock>(chain);
  const std::lock_guard<std::mutex> guard(chain_locks().changing);
  chain_locks().by_chain[chain] = lock;
  return lock;
}

}  // namespace

ChainLock::ChainLock(Chain chain) : chain_(chain), exclusion_("") {
  const CallsLock lock(calls_mutex);
  exclusion_.resume();
}

ChainLock::~ChainLock() {
  const std::lock_guard<std::mutex> guard(chain_locks().changing);
  const auto place = chain_locks().by_chain.find(chain_);
  // unless the chain has come in again since the last thread released this one
  if (place != chain_locks().by_chain.end() && place->second.expired())
    chain_locks().by_chain.erase(place);
}

Entry ChainLock::take(double limit) {
  CallsLock lock(calls_mutex);
  const Entry entry = exclusion_.enter(lock, no_chain, limit);
  if (entry <= Entry::late) holder_ = PyThread_get_thread_ident();
  return entry;
}

void ChainLock::give() {
  const CallsLock lock(calls_mutex);
  if (holder_ != PyThread_get_thread_ident()) return;
  holder_ = 0;
  exclusion_.leave();
}

std::shared_ptr<ChainLock> chain_lock_of(Chain chain) {
  auto lock = find(chain);
  return lock ? lock : begin(chain);
}

ChainRelease::ChainRelease(Chain chain) {
  auto lock = find(chain);
  if (!lock) {
    lock_ = begun = begin(chain);
  } else if (lock->holder_ == PyThread_get_thread_ident()) {
    lock->give();
    lock_ = std::move(lock);
  } else if (lock == begun) {  // a call back has run too long
    lock_ = std::move(lock);
  }
}

}  // namespace poise
