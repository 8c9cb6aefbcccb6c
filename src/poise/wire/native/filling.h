// Filling a block of shared memory while its receiver wakes up: src/poise/wire/connections/shared_memory.py.
//
// To wake a thread on another CPU takes about as long as to copy an array of 1 MB. So the
// receiver is woken before all of the block is there, and waits for the rest.
#pragma once

#include <sys/uio.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "channel.h"

namespace poise {

// A block's first word tells its owner. Only its first byte is ever set.
using Owner = std::uint32_t;

// Where the data of a block begin: the page before holds the owners.
std::size_t data_offset();

// The arrays that are copied to a block, one behind the other; in two steps, of which the
// second follows when the frame was sent.
class Filling {
 public:
  Filling() = default;
  Filling(Owner* owner, char* target, std::vector<iovec> arrays);

  void begin();
  void finish();

 private:
  void copy(std::size_t size);

  Owner* owner_ = nullptr;
  char* target_ = nullptr;
  std::vector<iovec> arrays_;
  std::size_t size_ = 0, left_ = 0;
  std::int64_t took_ = 0;  // [ns]
};

// Wait until the other end of `channel` has filled the block.
Outcome wait_until_filled(Owner* owner, const Channel& channel, double deadline);

inline bool is_being_filled(const Owner* owner) {
  return __atomic_load_n(owner, __ATOMIC_ACQUIRE) > 1;
}

}  // namespace poise
