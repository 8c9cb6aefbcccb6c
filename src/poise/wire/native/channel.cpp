#include "channel.h"

#include <poll.h>
#include <sys/socket.h>
#include <sys/time.h>

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cmath>
#include <cstring>
#include <ctime>

namespace poise {
namespace {

double now() {
  timespec moment{};
  clock_gettime(CLOCK_MONOTONIC, &moment);
  return static_cast<double>(moment.tv_sec) + 1e-9 * static_cast<double>(moment.tv_nsec);
}

// What the failure of a system call means; `done` when it is to be tried again.
Outcome failed() {
  if (errno == EINTR) return Outcome::interrupted;
  return errno == EAGAIN || errno == EWOULDBLOCK ? Outcome::done : Outcome::gone;
}

// Take `count` sent bytes off the front.
void drop(std::vector<iovec>& pieces, std::size_t count) {
  auto piece = pieces.begin();
  for (; piece != pieces.end() && count >= piece->iov_len; ++piece) count -= piece->iov_len;
  pieces.erase(pieces.begin(), piece);
  if (count == 0) return;
  pieces.front().iov_base = static_cast<char*>(pieces.front().iov_base) + count;
  pieces.front().iov_len -= count;
}

}  // namespace

Channel::Channel(int file)
    : file_(file),
      ahead_(ahead_size),
      receiving_{SO_RCVTIMEO, POLLIN},
      sending_{SO_SNDTIMEO, POLLOUT} {}

// Make sure that the next system call ends about when the deadline is there. The kernel
// keeps a limit that it was told, which spares most calls a poll before them.
Outcome Channel::wait(Side& side, double deadline, int& flags) {
  if (!std::isfinite(deadline)) return side.limit == 0.0 ? Outcome::done : tell_limit(side, 0.0);
  const double left = deadline - now();
  if (left <= 0.0) return Outcome::late;
  if (side.limit < 0.5 * left) return tell_limit(side, left);
  if (side.limit <= 1.1 * left) return Outcome::done;
  flags |= MSG_DONTWAIT;
  pollfd waiting{file_, side.events, 0};
  const double milliseconds = std::ceil(std::min(1e3 * left, 1e9));
  const int ready = poll(&waiting, 1, static_cast<int>(milliseconds));
  if (ready == 0) return Outcome::late;
  return ready < 0 ? failed() : Outcome::done;
}

Outcome Channel::tell_limit(Side& side, double limit) {
  timeval told{};
  told.tv_sec = static_cast<time_t>(std::min(limit, 1e8));
  told.tv_usec = static_cast<suseconds_t>((limit - std::floor(limit)) * 1e6);
  if (limit > 0.0 && told.tv_sec == 0 && told.tv_usec == 0) told.tv_usec = 1;  // 0 is for ever
  if (setsockopt(file_, SOL_SOCKET, side.option, &told, sizeof told) != 0) return Outcome::gone;
  side.limit = limit;
  return Outcome::done;
}

Outcome Channel::send(std::vector<iovec>& pieces, double deadline) {
  while (!pieces.empty()) {
    int flags = MSG_NOSIGNAL;
    const Outcome waited = wait(sending_, deadline, flags);
    if (waited != Outcome::done) return waited;
    msghdr message{};
    message.msg_iov = pieces.data();
    message.msg_iovlen = std::min<std::size_t>(pieces.size(), IOV_MAX);
    const ssize_t sent = sendmsg(file_, &message, flags);
    if (sent >= 0) {
      drop(pieces, static_cast<std::size_t>(sent));
    } else if (const Outcome outcome = failed(); outcome != Outcome::done) {
      return outcome;
    }
  }
  return Outcome::done;
}

Outcome Channel::receive_head(Head& head, double deadline) {
  constexpr std::size_t plain = sizeof head.length + sizeof head.block;
  Outcome outcome = fetch(plain, deadline);
  if (outcome != Outcome::done) return outcome;
  const char* bytes = ahead_.data() + start_;
  std::memcpy(&head.length, bytes, sizeof head.length);
  std::memcpy(&head.block, bytes + sizeof head.length, sizeof head.block);
  std::size_t size = plain;
  if (head.block != 0) {
    size += sizeof head.used;
    outcome = fetch(size, deadline);
    if (outcome != Outcome::done) return outcome;
    std::memcpy(&head.used, ahead_.data() + start_ + plain, sizeof head.used);
  }
  start_ += size;
  return Outcome::done;
}

Outcome Channel::take(char*& target, std::size_t& left, double deadline) {
  const std::size_t ready = std::min(left, num_ahead());
  std::memcpy(target, ahead_.data() + start_, ready);
  start_ += ready;
  target += ready;
  left -= ready;
  while (left > 0) {
    std::size_t got = 0;
    const Outcome outcome = read(target, left, deadline, got);
    if (outcome != Outcome::done) return outcome;
    target += got;
    left -= got;
  }
  return Outcome::done;
}

// Have at least `count` bytes ahead.
Outcome Channel::fetch(std::size_t count, double deadline) {
  if (num_ahead() == 0) {
    start_ = end_ = 0;
  } else if (start_ + count > ahead_.size()) {
    std::memmove(ahead_.data(), ahead_.data() + start_, num_ahead());
    end_ -= start_;
    start_ = 0;
  }
  while (num_ahead() < count) {
    std::size_t got = 0;
    const Outcome outcome = read(ahead_.data() + end_, ahead_.size() - end_, deadline, got);
    if (outcome != Outcome::done) return outcome;
    end_ += got;
  }
  return Outcome::done;
}

Outcome Channel::read(char* target, std::size_t size, double deadline, std::size_t& got) {
  while (true) {
    int flags = 0;
    const Outcome waited = wait(receiving_, deadline, flags);
    if (waited != Outcome::done) return waited;
    const ssize_t count = recv(file_, target, size, flags);
    if (count > 0) {
      got = static_cast<std::size_t>(count);
      return Outcome::done;
    }
    if (count == 0) {
      errno = 0;
      return Outcome::gone;
    }
    const Outcome outcome = failed();
    if (outcome != Outcome::done) return outcome;
  }
}

}  // namespace poise
