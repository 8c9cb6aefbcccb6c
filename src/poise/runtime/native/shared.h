// Numbers that a container writes, under its GIL, and its agent reads at any time.
#pragma once

#include <atomic>

namespace poise {

template <typename Number>
class Shared {
  static_assert(std::atomic<Number>::is_always_lock_free);

 public:
  Shared(Number value = Number{}) : value_(value) {}
  Shared(const Shared& other) : value_(other.get()) {}
  Shared& operator=(const Shared& other) {
    set(other.get());
    return *this;
  }

  Number get() const { return value_.load(std::memory_order_acquire); }
  void set(Number value) { value_.store(value, std::memory_order_release); }

  // One thread at a time writes, so no locked instruction is needed.
  void add(Number more) {
    value_.store(value_.load(std::memory_order_relaxed) + more, std::memory_order_relaxed);
  }

 private:
  std::atomic<Number> value_;
};

}  // namespace poise
