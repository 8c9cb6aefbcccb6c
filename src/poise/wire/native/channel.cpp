#include "channel.h"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <climits>
#include <cmath>
#include <cstring>
#include <ctime>

namespace poise {

double now() {
  timespec moment{};
  clock_gettime(CLOCK_MONOTONIC, &moment);
  return static_cast<double>(moment.tv_sec) + 1e-9 * static_cast<double>(moment.tv_nsec);
}

namespace {

// A thread that waits checks after this time whether the other computer is still there [s].
constexpr double look_after = 1.0;

// Retransmissions or probes before a computer counts as silent: one that was itself suspended has
// heard nothing for long, and is answered at once.
constexpr int in_vain = 2;
// Files that came and belong to frames which were not taken yet.
constexpr std::size_t most_files = 8;

// The meaning of a failed system call; `done` when it is to be tried again.
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

// Room for one open file beside the bytes of a message.
class FileRights {
 public:
  void expect(msghdr& message) {
    message.msg_control = memory_;
    // not all of the memory, which is rounded up and would have room for a second file
    message.msg_controllen = CMSG_LEN(sizeof(int));
  }

  void attach(msghdr& message, int file) {
    expect(message);
    cmsghdr* part = CMSG_FIRSTHDR(&message);
    part->cmsg_level = SOL_SOCKET;
    part->cmsg_type = SCM_RIGHTS;
    part->cmsg_len = CMSG_LEN(sizeof file);
    std::memcpy(CMSG_DATA(part), &file, sizeof file);
  }

  static int found(msghdr& message) {
    const cmsghdr* part = CMSG_FIRSTHDR(&message);
    int file = no_file;
    if (part && part->cmsg_level == SOL_SOCKET && part->cmsg_type == SCM_RIGHTS)
      std::memcpy(&file, CMSG_DATA(part), sizeof file);
    return file;
  }

 private:
  alignas(cmsghdr) char memory_[CMSG_SPACE(sizeof(int))] = {};
};

// What TCP knows; all 0 over AF_UNIX.
tcp_info look(int file) {
  tcp_info found{};
  socklen_t size = sizeof found;
  if (getsockopt(file, IPPROTO_TCP, TCP_INFO, &found, &size) != 0) return tcp_info{};
  return found;
}

}  // namespace

Channel::Channel(int file, double lost_after, bool reads_ahead)
    : file_(file),
      lost_after_(lost_after),
      is_remote_(look(file).tcpi_state != 0),
      reads_ahead_(reads_ahead),
      ahead_(reads_ahead ? ahead_size : Head::with_block) {}

Channel::~Channel() {
  for (const int file : files_) close(file);
}

bool Channel::is_lost() const {
  const tcp_info found = look(file_);
  // while this computer's own cable is out, TCP sends nothing, and probes
  const bool repeats = found.tcpi_unacked > 0 && found.tcpi_retransmits >= in_vain;
  return (repeats || found.tcpi_probes >= in_vain) &&
         found.tcpi_last_ack_recv > 1e3 * lost_after_;
}

bool Channel::is_gone() const {
  pollfd looking{file_, POLLRDHUP, 0};
  return poll(&looking, 1, 0) > 0;
}

int Channel::take_file() {
  if (files_.empty()) return no_file;
  const int file = files_.front();
  files_.pop_front();
  return file;
}

// Reading waits here and not in `recv`, because that is
// woken in vain when the other end takes what was sent.
Outcome Channel::wait(short event, double deadline) {
  while (true) {
    const double began = now();
    if (began >= deadline) return Outcome::late;
    const double until = is_remote_ ? std::min(deadline, began + look_after) : deadline;
    const double milliseconds = std::ceil(1e3 * std::min(until - began, 1e6));
    pollfd waiting{file_, event, 0};
    const bool ends = std::isfinite(until);
    const int ready = poll(&waiting, 1, ends ? static_cast<int>(milliseconds) : -1);
    if (ready > 0) return Outcome::done;
    if (ready < 0) return failed();
    if (is_lost()) {
      errno = ETIMEDOUT;
      return Outcome::gone;
    }
  }
}

Outcome Channel::send(std::vector<iovec>& pieces, double deadline, int& attached) {
  while (!pieces.empty()) {
    msghdr message{};
    message.msg_iov = pieces.data();
    message.msg_iovlen = std::min<std::size_t>(pieces.size(), IOV_MAX);
    FileRights rights;
    if (attached != no_file) rights.attach(message, attached);
    const ssize_t sent = sendmsg(file_, &message, MSG_NOSIGNAL | MSG_DONTWAIT);
    if (sent >= 0) {
      attached = no_file;
      drop(pieces, static_cast<std::size_t>(sent));
      continue;
    }
    Outcome outcome = failed();
    if (outcome == Outcome::done) outcome = wait(POLLOUT, deadline);
    if (outcome != Outcome::done) return outcome;
  }
  return Outcome::done;
}

Outcome Channel::receive_head(Head& head, double deadline) {
  Outcome outcome = fetch(Head::plain, deadline);
  if (outcome != Outcome::done) return outcome;
  head.used = 0;
  std::memcpy(static_cast<void*>(&head), ahead_.data() + start_, Head::plain);
  std::size_t size = Head::plain;
  if (head.block != 0) {
    size = Head::with_block;
    outcome = fetch(size, deadline);
    if (outcome != Outcome::done) return outcome;
    std::memcpy(static_cast<void*>(&head), ahead_.data() + start_, size);
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
    const std::size_t wanted = reads_ahead_ ? ahead_.size() - end_ : count - num_ahead();
    const Outcome outcome = read(ahead_.data() + end_, wanted, deadline, got);
    if (outcome != Outcome::done) return outcome;
    end_ += got;
  }
  return Outcome::done;
}

Outcome Channel::read(char* target, std::size_t size, double deadline, std::size_t& got) {
  while (true) {
    Outcome outcome = wait(POLLIN, deadline);
    if (outcome != Outcome::done) return outcome;
    FileRights rights;
    iovec into{target, size};
    msghdr message{};
    message.msg_iov = &into;
    message.msg_iovlen = 1;
    rights.expect(message);
    const ssize_t count = recvmsg(file_, &message, MSG_DONTWAIT | MSG_CMSG_CLOEXEC);
    if (count > 0) {
      if (const int file = FileRights::found(message); file != no_file) files_.push_back(file);
      if (files_.size() > most_files) {  // nobody asks for them: the other end leaks
        errno = EPROTO;
        return Outcome::gone;
      }
      got = static_cast<std::size_t>(count);
      return Outcome::done;
    }
    if (count == 0) {
      errno = 0;
      return Outcome::gone;
    }
    outcome = failed();
    if (outcome != Outcome::done) return outcome;
  }
}

}  // namespace poise
