#include <Python.h>

#include "exclusion.h"

#include <semaphore.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <ctime>
#include <optional>

#include <poise/unlocked.hpp>

namespace poise {

struct Exclusion::Waiter {
  Waiter(Chain wanted, bool returns) : chain(wanted), steps_in(returns) {
    sem_init(&woken, 0, 0);
  }
  ~Waiter() { sem_destroy(&woken); }

  void wake(Entry outcome) {
    entry = outcome;
    sem_post(&woken);
  }

  sem_t woken;
  Chain chain;
  bool steps_in;
  Entry entry = Entry::timeout;  // until somebody wakes it
};

static timespec moment_in(double seconds) {
  constexpr double longest = 1e8;  // three years
  seconds = seconds > 0.0 ? std::min(seconds, longest) : 0.0;
  timespec moment{};
  clock_gettime(CLOCK_MONOTONIC, &moment);
  const double whole = std::floor(seconds);
  moment.tv_sec += static_cast<time_t>(whole);
  moment.tv_nsec += static_cast<long>((seconds - whole) * 1e9);
  if (moment.tv_nsec >= 1'000'000'000) {
    moment.tv_nsec -= 1'000'000'000;
    ++moment.tv_sec;
  }
  return moment;
}

bool Exclusion::release() {
  if (!held_) return false;
  owner_ = no_chain;
  const auto place = std::find_if(waiting_.begin(), waiting_.end(),
                                  [this](Waiter* waiter) { return may_have(waiter->chain); });
  if (place == waiting_.end()) {
    held_ = false;
    return true;
  }
  Waiter* next = *place;
  waiting_.erase(place);
  owner_ = next->chain;
  next->wake(Entry::late);
  return true;
}

void Exclusion::redirect() {
  redirected_ = true;
  std::deque<Waiter*> staying;
  for (Waiter* waiter : waiting_) {
    if (waiter->steps_in)
      staying.push_back(waiter);
    else
      waiter->wake(Entry::redirected);
  }
  waiting_.swap(staying);
}

Entry Exclusion::step_in(CallsLock& lock, Chain chain, int depth, double limit) {
  Entry entry = Entry::entered;
  if (held_) {
    entry = wait(lock, chain, limit, true);
    if (entry != Entry::late) return entry;
  }
  held_ = true;
  owner_ = chain;
  depth_ = depth;
  --outside_;
  return entry;
}

Entry Exclusion::wait(CallsLock& lock, Chain chain, double limit, bool steps_in) {
  const timespec until = moment_in(limit);
  Waiter waiter(chain, steps_in);
  waiting_.push_back(&waiter);
  lock.unlock();
  const bool has_gil = PyGILState_Check();
  int error = 0;
  do {
    std::optional<Unlocked> unlocked;
    if (has_gil) unlocked.emplace();
    error = sem_clockwait(&waiter.woken, CLOCK_MONOTONIC, &until) ? errno : 0;
  } while (error == EINTR && (!has_gil || PyErr_CheckSignals() == 0));
  lock.lock();
  // If nobody took it off the list, it gives up.
  const auto place = std::find(waiting_.begin(), waiting_.end(), &waiter);
  if (place != waiting_.end()) waiting_.erase(place);
  if (error != EINTR) return waiter.entry;
  if (waiter.entry == Entry::late) release();
  return Entry::interrupted;
}

}  // namespace poise
