// Filling a block of shared memory while its receiver wakes up: src/poise/wire/connections/shared_memory.py.
//
// To wake a thread on another CPU takes about as long as to copy an array of 1 MB. So the
// receiver is told of a block before all is there, and waits for the rest.
#pragma once

#include <sys/uio.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "channel.h"

namespace poise {

// A block's first word: whose the block is. Its first byte says it, for the others are 0.
using Mark = std::uint32_t;

// Where the data of a block begin: the page before is for marks.
std::size_t data_offset();

// The arrays that are copied to a block, one behind the other; in two steps, of which the
// second follows when the receiver was told.
class Filling {
 public:
  Filling() = default;
  Filling(Mark* mark, char* target, std::vector<iovec> arrays);

  void begin();
  void finish();

 private:
  void copy(std::size_t size);

  Mark* mark_ = nullptr;
  char* target_ = nullptr;
  std::vector<iovec> arrays_;
  std::size_t size_ = 0, left_ = 0;
  std::int64_t took_ = 0;  // [ns]
};

// Wait until the other end of `channel` has filled the block.
Outcome wait_until_filled(Mark* mark, const Channel& channel, double deadline);

inline bool is_being_filled(const Mark* mark) {
  return __atomic_load_n(mark, __ATOMIC_ACQUIRE) > 1;
}

}  // namespace poise
