// The call that runs now over one end of a connector. Its CPU time is counted when it ends;
// until then the agent asks the kernel for that of its thread.
#pragma once

#include <cstdint>

#include "../shared_number.h"

namespace poise {

// 0: not asked for yet.
inline thread_local std::int32_t thread_number = 0;

std::int32_t ask_thread_number();

inline std::int32_t this_thread() {
  return thread_number ? thread_number : ask_thread_number();
}

class RunningCall {
 public:
  // False when a call further out on this thread runs already, and stays the one that runs.
  // Of two threads, which only re-entrant components have, the later takes the place.
  bool begin() {
    const std::int32_t thread = this_thread();
    if (thread_.get() == thread) return false;
    number_.add(1);
    thread_.set(thread);
    return true;
  }
  // Call it before the call is counted, so that it never counts twice.
  void end() {
    if (thread_.get() == this_thread()) thread_.set(0);
  }

  std::int32_t thread() const { return thread_.get(); }  // 0: none runs
  std::uint64_t number() const { return number_.get(); }  // every call has another

 private:
  Shared<std::int32_t> thread_;
  Shared<std::uint64_t> number_;
};

}  // namespace poise
