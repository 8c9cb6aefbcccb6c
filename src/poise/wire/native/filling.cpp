#include "filling.h"

#include <linux/futex.h>
#include <sched.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <ctime>
#include <utility>

#include "copy.h"

namespace poise {
namespace {

enum : Mark { lent = 1, being_filled = 2, awaited = 3 };

// About what it takes until a thread that sleeps on another CPU runs [ns].
constexpr std::int64_t wake_up = 30'000;
// Who waits longer than this for the rest goes to sleep [s].
constexpr double patience = 50e-6;
// Who sleeps looks so often whether the other end is there still [ns].
constexpr std::int64_t look_every = 50'000'000;

// What was copied in a nanosecond the last time [bytes].
std::atomic<double> speed{0.0};

std::int64_t now_ns() {
  timespec moment{};
  clock_gettime(CLOCK_MONOTONIC, &moment);
  return moment.tv_sec * std::int64_t{1'000'000'000} + moment.tv_nsec;
}

long futex(Mark* mark, int operation, Mark value, const timespec* limit = nullptr) {
  return syscall(SYS_futex, mark, operation, value, limit, nullptr, 0);
}

}  // namespace

std::size_t data_offset() {
  static const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  return page;
}

Filling::Filling(Mark* mark, char* target, std::vector<iovec> arrays)
    : mark_(mark), target_(target), arrays_(std::move(arrays)) {
  for (const iovec& array : arrays_) left_ += array.iov_len;
  size_ = left_;
}

// Leave for later what is copied while the receiver wakes up.
void Filling::begin() {
  if (!mark_) return;
  __atomic_store_n(mark_, being_filled, __ATOMIC_RELEASE);
  const double meanwhile = static_cast<double>(wake_up) * speed.load(std::memory_order_relaxed);
  if (meanwhile < static_cast<double>(left_)) copy(left_ - static_cast<std::size_t>(meanwhile));
}

void Filling::finish() {
  if (!mark_) return;
  copy(left_);
  if (__atomic_exchange_n(mark_, lent, __ATOMIC_ACQ_REL) == awaited) futex(mark_, FUTEX_WAKE, 1);
  const double took = static_cast<double>(std::max<std::int64_t>(took_, 1));
  speed.store(static_cast<double>(size_) / took, std::memory_order_relaxed);
}

// Copy the next `size` bytes.
void Filling::copy(std::size_t size) {
  const std::int64_t began = now_ns();
  left_ -= size;
  while (size > 0) {
    iovec& array = arrays_.front();
    const std::size_t part = std::min(size, array.iov_len);
    copy_shared(target_, array.iov_base, part);
    target_ += part;
    size -= part;
    array.iov_base = static_cast<char*>(array.iov_base) + part;
    array.iov_len -= part;
    if (array.iov_len == 0) arrays_.erase(arrays_.begin());
  }
  took_ += now_ns() - began;
}

Outcome wait_until_filled(Mark* mark, const Channel& channel, double deadline) {
  const double asleep = std::min(now() + patience, deadline);
  do {
    if (!is_being_filled(mark)) return Outcome::done;
    sched_yield();  // on one CPU the sender goes on
  } while (now() < asleep);
  while (true) {
    Mark seen = being_filled;
    __atomic_compare_exchange_n(mark, &seen, awaited, false, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE);
    if (!is_being_filled(mark)) return Outcome::done;
    if (now() >= deadline) return Outcome::late;
    const timespec limit{0, look_every};
    if (futex(mark, FUTEX_WAIT, awaited, &limit) == 0 || errno == EAGAIN) continue;
    if (errno == EINTR) return Outcome::interrupted;
    if (channel.is_gone() && is_being_filled(mark)) {
      errno = 0;
      return Outcome::gone;
    }
  }
}

}  // namespace poise
