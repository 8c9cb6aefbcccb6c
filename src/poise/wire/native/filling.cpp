#include "filling.h"

#include <sched.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <utility>

namespace poise {
namespace {

// What is copied while the receiver wakes up, which takes about 30 us [bytes].
constexpr std::size_t meanwhile = 1 << 18;
// A receiver that waits longer than this for the rest sleeps, so long at a time [s].
constexpr double patience = 50e-6;

// As `memcpy`. A block that the receiver has read is in its CPU's cache: to write it piece by
// piece first fetches each line from there. `rep movsb` writes whole lines and fetches none.
void copy_shared(void* target, const void* source, std::size_t size) {
#if defined(__x86_64__)
  __asm__ volatile("rep movsb" : "+D"(target), "+S"(source), "+c"(size) : : "memory");
#else
  std::memcpy(target, source, size);
#endif
}

}  // namespace

std::size_t data_offset() {
  static const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  return page;
}

Filling::Filling(char* block, std::size_t slot, std::vector<iovec> arrays)
    : slot_(block + slot), target_(block + data_offset()), arrays_(std::move(arrays)) {
  for (const iovec& array : arrays_) left_ += array.iov_len;
}

void Filling::begin() {
  if (!slot_) return;
  __atomic_store_n(slot_, is_being_filled, __ATOMIC_RELEASE);
  if (left_ > meanwhile) copy(left_ - meanwhile);
}

void Filling::finish() {
  if (!slot_) return;
  copy(left_);
  __atomic_store_n(slot_, is_lent, __ATOMIC_RELEASE);
}

// Copy the next `size` bytes.
void Filling::copy(std::size_t size) {
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
}

Outcome wait_until_filled(const char* slot, const Channel& channel, double deadline) {
  const double asleep = now() + patience;
  while (is_filling(slot)) {
    const double moment = now();
    if (moment >= deadline) return Outcome::late;
    if (moment < asleep) {
      sched_yield();  // on one CPU the sender goes on
      continue;
    }
    const timespec pause{0, static_cast<long>(1e9 * patience)};
    if (nanosleep(&pause, nullptr) != 0) return Outcome::interrupted;
    if (channel.is_gone() && is_filling(slot)) {
      errno = 0;
      return Outcome::gone;
    }
  }
  return Outcome::done;
}

}  // namespace poise
