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

enum : Owner { lent = 1, being_filled = 2, awaited = 3 };

// About what it takes until a thread that sleeps on another CPU runs [ns].
constexpr std::int64_t wake_up = 30'000;
// A receiver that waits longer than this for the rest sleeps [s].
constexpr double patience = 50e-6;
// A receiver that sleeps checks this often whether the other end is still there [ns].
constexpr std::int64_t look_every = 50'000'000;

// What was copied in a nanosecond the last time [bytes].
std::atomic<double> speed{0.0};

std::int64_t now_ns() {
  timespec moment{};
  clock_gettime(CLOCK_MONOTONIC, &moment);
  return moment.tv_sec * std::int64_t{1'000'000'000} + moment.tv_nsec;
}

long futex(Owner* owner, int operation, Owner value, const timespec* limit = nullptr) {
  return syscall(SYS_futex, owner, operation, value, limit, nullptr, 0);
}

}  // namespace

std::size_t data_offset() {
  static const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  return page;
}

Filling::Filling(Owner* owner, char* target, std::vector<iovec> arrays)
    : owner_(owner), target_(target), arrays_(std::move(arrays)) {
  for (const iovec& array : arrays_) left_ += array.iov_len;
  size_ = left_;
}

// Leave for later what is copied while the receiver wakes up.
void Filling::begin() {
  if (!owner_) return;
  __atomic_store_n(owner_, being_filled, __ATOMIC_RELEASE);
  const double meanwhile = static_cast<double>(wake_up) * speed.load(std::memory_order_relaxed);
  if (meanwhile < static_cast<double>(left_)) copy(left_ - static_cast<std::size_t>(meanwhile));
}

void Filling::finish() {
  if (!owner_) return;
  copy(left_);
  if (__atomic_exchange_n(owner_, lent, __ATOMIC_ACQ_REL) == awaited) futex(owner_, FUTEX_WAKE, 1);
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

Outcome wait_until_filled(Owner* owner, const Channel& channel, double deadline) {
  const double asleep = std::min(now() + patience, deadline);
  do {
    if (!is_being_filled(owner)) return Outcome::done;
    sched_yield();  // on one CPU the sender goes on
  } while (now() < asleep);
  while (true) {
    Owner seen = being_filled;
    __atomic_compare_exchange_n(owner, &seen, awaited, false, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE);
    if (!is_being_filled(owner)) return Outcome::done;
    if (now() >= deadline) return Outcome::late;
    const timespec limit{0, look_every};
    if (futex(owner, FUTEX_WAIT, awaited, &limit) == 0 || errno == EAGAIN) continue;
    if (errno == EINTR) return Outcome::interrupted;
    if (channel.is_gone() && is_being_filled(owner)) {
      errno = 0;
      return Outcome::gone;
    }
  }
}

}  // namespace poise
