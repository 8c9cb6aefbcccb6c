// Length-prefixed pieces of bytes over a connected stream socket.
//
//   length u32, block u32, [used u64 when block is not 0,] `length` bytes
//
// src/poise/wire/connections/connection.py says what the numbers mean. Nothing here knows
// Python: waiting and copying happen without its lock. One thread at a time may send, and one
// receive. Over AF_UNIX, open files cross with the bytes.
#pragma once

#include <sys/uio.h>

#include <cstddef>
#include <cstdint>
#include <deque>
#include <vector>

namespace poise {

double now();  // of the monotonic clock [s]

// What a step came to.
enum class Outcome {
  done,
  late,         // not before the deadline
  gone,         // the other end closed, or the socket broke; `errno` or 0
  interrupted,  // by a signal: look at it, and go on
};

constexpr int no_file = -1;

// As it lies on the wire; little endian, as every computer that runs Poise.
struct Head {
  static constexpr std::size_t plain = 8;  // without `used`
  static constexpr std::size_t with_block = 16;

  std::uint32_t length = 0;
  std::uint32_t block = 0;
  std::uint64_t used = 0;
};
static_assert(sizeof(Head) == Head::with_block);

class Channel {
 public:
  // Over TCP the other end is lost when it confirms nothing for `lost_after` [s]. A channel
  // that does not read ahead keeps nothing between two frames: `poll` reports each frame.
  Channel(int file, double lost_after, bool reads_ahead);
  ~Channel();
  Channel(const Channel&) = delete;
  Channel& operator=(const Channel&) = delete;

  // Send all of `pieces` before `deadline` [s, of the monotonic clock], and take off what
  // was sent; with the first bytes goes an open file, unless `attached` is `no_file`.
  Outcome send(std::vector<iovec>& pieces, double deadline, int& attached);

  // Have a head; call `take` or `skip` for what follows it.
  Outcome receive_head(Head& head, double deadline);

  // Copy the next bytes to `target`, moving it on, until `left` is 0.
  Outcome take(char*& target, std::size_t& left, double deadline);

  // Sleep until the socket is ready, or its computer is lost.
  Outcome wait(short event, double deadline);

  // Whether the other computer was silent for too long about something that was sent. A
  // process that takes nothing does no harm: its computer says so.
  bool is_lost() const;

  // Whether the other end has closed the socket, or its process ended.
  bool is_gone() const;

  // The first file that came and was not taken; `no_file` when there is none.
  int take_file();

  // How many bytes are here already, behind the last head.
  std::size_t num_ahead() const { return end_ - start_; }

  // The next `count` bytes, which are here already; valid until the next step.
  const char* skip(std::size_t count) {
    const char* bytes = ahead_.data() + start_;
    start_ += count;
    return bytes;
  }

 private:
  // Bytes to read at once: nearly every frame comes in one system call.
  static constexpr std::size_t ahead_size = 1 << 13;

  Outcome fetch(std::size_t count, double deadline);
  Outcome read(char* target, std::size_t size, double deadline, std::size_t& got);

  int file_;
  double lost_after_;
  bool is_remote_, reads_ahead_;
  std::vector<char> ahead_;
  std::deque<int> files_;
  std::size_t start_ = 0, end_ = 0;
};

}  // namespace poise
