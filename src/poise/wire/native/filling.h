// Filling a block of shared memory while its receiver wakes up: src/poise/wire/connections/blocks.py.
//
// To wake a thread on another CPU takes about as long as to copy an array of 1 MB. So the frame is
// sent before all of the block is there, and the receiver waits for the rest.
#pragma once

#include <sys/uio.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "channel.h"

namespace poise {

// What the byte of a receiver says; blocks.py has the first two.
enum Slot : std::uint8_t { is_free, is_lent, is_being_filled };

// The arrays that are copied to a block, one behind the other; in two steps, of which the second
// follows when the frame was sent.
class Filling {
 public:
  Filling() = default;
  // `block` is its memory, and `slot` the number of the receiver's byte in it.
  Filling(char* block, std::size_t slot, std::vector<iovec> arrays);

  void begin();
  void finish();

 private:
  void copy(std::size_t size);

  char* slot_ = nullptr;
  char* target_ = nullptr;
  std::vector<iovec> arrays_;
  std::size_t left_ = 0;
};

inline bool is_filling(const char* slot) {
  return __atomic_load_n(slot, __ATOMIC_ACQUIRE) == is_being_filled;
}

// Wait until the other end of `channel` has filled the block.
Outcome wait_until_filled(const char* slot, const Channel& channel, double deadline);

// Where the data of a block begin: the page before holds the slots.
std::size_t data_offset();

}  // namespace poise
