// The call chain of each thread: poise/runtime/execution/exclusion.py says what a chain is.
#pragma once

#include <cstdint>

namespace poise {

using Chain = std::uint64_t;

// Nobody's chain: no thread is ever in it.
constexpr Chain no_chain = 0;

extern thread_local Chain thread_chain;

// Let the numbers of this process go on from `first`; also ends this thread's chain. In a
// forked process, call it before anything else here.
void begin_chains(Chain first);

// Begin a chain on this thread.
Chain new_chain();

inline Chain current_chain() {
  return thread_chain != no_chain ? thread_chain : new_chain();
}

}  // namespace poise
