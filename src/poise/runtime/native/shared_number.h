// Numbers that a container writes, under its GIL, and its agent reads at any time.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <cstring>
#include <string>

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

  // One thread at a time writes, so no locked instruction is needed. Who sees the sum sees what
  // that thread wrote before: a call that is counted does not seem to run still.
  void add(Number more) {
    value_.store(value_.load(std::memory_order_relaxed) + more, std::memory_order_release);
  }

 private:
  std::atomic<Number> value_;
};

// A short text, for records that are filled and read under a sequence lock.
template <std::size_t Size>
class SharedText {
  static_assert(Size % sizeof(std::uint64_t) == 0);

 public:
  static constexpr std::size_t max_length = Size - 1;

  void set(const std::string& text) {
    char bytes[Size] = {};
    std::memcpy(bytes, text.data(), std::min(text.size(), max_length));
    for (std::size_t i = 0; i < words_.size(); ++i) {
      std::uint64_t word;
      std::memcpy(&word, bytes + i * sizeof word, sizeof word);
      words_[i].set(word);
    }
  }

  std::string get() const {
    char bytes[Size];
    for (std::size_t i = 0; i < words_.size(); ++i) {
      const std::uint64_t word = words_[i].get();
      std::memcpy(bytes + i * sizeof word, &word, sizeof word);
    }
    return std::string(bytes, strnlen(bytes, max_length));
  }

 private:
  std::array<Shared<std::uint64_t>, Size / sizeof(std::uint64_t)> words_;
};

}  // namespace poise
