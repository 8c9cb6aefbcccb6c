#include "chain.h"

#include <atomic>

#include "counters/running_call.h"
#include "deadline.h"
#include "exclusion.h"

namespace poise {

thread_local Chain thread_chain = no_chain;
thread_local Moment thread_deadline = never;
thread_local const Exclusion* thread_called = nullptr;

static std::atomic<Chain> next = 1;

void begin_chains(Chain first) {
  next = first;
  thread_chain = no_chain;
  thread_number = 0;  // of the thread that forked
}

Chain new_chain() { return thread_chain = next++; }

}  // namespace poise
