// Length-prefixed pieces of bytes over a connected stream socket.
//
//   length u32, block u32, [used u64 when block is not 0,] `length` bytes
//
// src/poise/wire/link.py says what the numbers mean. Nothing here knows Python: waiting
// and copying happen without its lock. One thread at a time may send, and one receive.
#pragma once

#include <sys/uio.h>

#include <cstddef>
#include <cstdint>
#include <vector>

namespace poise {

// What a step came to.
enum class Outcome {
  done,
  late,         // not before the deadline
  gone,         // the other end closed, or the socket broke; `errno` or 0
  interrupted,  // by a signal: look at it, and go on
};

struct Head {
  std::uint32_t length = 0;
  std::uint32_t block = 0;
  std::uint64_t used = 0;
};

class Channel {
 public:
  explicit Channel(int file);

  // Send all of `pieces` before `deadline` [s, of the monotonic clock], and take off what
  // was sent.
  Outcome send(std::vector<iovec>& pieces, double deadline);

  // Have a head; call `take` for what follows it.
  Outcome receive_head(Head& head, double deadline);

  // Copy the next bytes to `target`, moving it on, until `left` is 0.
  Outcome take(char*& target, std::size_t& left, double deadline);

  // How many bytes are here already, behind the last head.
  std::size_t num_ahead() const { return end_ - start_; }

 private:
  // So many bytes are asked for at once: nearly every frame comes in one system call.
  static constexpr std::size_t ahead_size = 1 << 13;

  Outcome fetch(std::size_t count, double deadline);
  Outcome read(char* target, std::size_t size, double deadline, std::size_t& got);

  // One direction, and the time limit that the kernel was told for it.
  struct Side {
    int option;
    short events;
    double limit = 0.0;  // [s]; 0: the kernel waits for ever
  };

  Outcome wait(Side& side, double deadline, int& flags);
  Outcome tell_limit(Side& side, double limit);

  int file_;
  std::vector<char> ahead_;
  std::size_t start_ = 0, end_ = 0;
  Side receiving_, sending_;
};

}  // namespace poise
