// Lists of items, one after the other in memory.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace poise {

template <typename T>
struct Span {
  const T* first;
  const T* last;
  const T* begin() const { return first; }
  const T* end() const { return last; }
  std::size_t size() const { return static_cast<std::size_t>(last - first); }
};

template <typename T>
Span<T> all_of(const std::vector<T>& items) {
  return {items.data(), items.data() + items.size()};
}

// A list for each unit.
template <typename T>
class Lists {
 public:
  bool empty() const { return items_.empty(); }
  Span<T> of(int unit) const {
    if (items_.empty()) return {nullptr, nullptr};
    return {items_.data() + starts_[unit], items_.data() + starts_[unit + 1]};
  }
  // Fill the lists of n units: `each` calls its argument with (unit, item) for all items,
  // always in the same order.
  template <typename Each>
  void fill(int n, Each each) {
    starts_.assign(n + 1, 0);
    each([&](int unit, const T&) { ++starts_[unit + 1]; });
    for (int i = 0; i < n; ++i) starts_[i + 1] += starts_[i];
    items_.resize(starts_[n]);
    std::vector<std::int64_t> next(starts_.begin(), starts_.end() - 1);
    each([&](int unit, const T& item) { items_[next[unit]++] = item; });
  }

 private:
  std::vector<std::int64_t> starts_;
  std::vector<T> items_;
};

}  // namespace poise
