// The call chain of each thread: poise/runtime/execution/exclusion.py says what a chain is.
#pragma once

#include <cstdint>

namespace poise {

using Chain = std::uint64_t;

// Nobody's chain: no thread is ever in it.
constexpr Chain no_chain = 0;

// A local call reads and writes three of them: a call of the linker for each would take longer
// than the lock. glibc keeps room for such few bytes of libraries that are loaded late.
#define POISE_NEAR_THREAD_LOCAL [[gnu::tls_model("initial-exec")]] extern thread_local

POISE_NEAR_THREAD_LOCAL Chain thread_chain;

// Let the numbers of this process go on from `first`; also ends this thread's chain. In a
// forked process, call it before anything else here.
void begin_chains(Chain first);

// Begin a chain on this thread.
Chain new_chain();

inline Chain current_chain() {
  return thread_chain != no_chain ? thread_chain : new_chain();
}

}  // namespace poise
