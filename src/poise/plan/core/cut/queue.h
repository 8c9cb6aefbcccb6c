// A priority queue of nodes by gain, largest first, whose entries can change.
#pragma once

#include <cstdint>
#include <vector>

namespace poise::cut {

class Queue {
 public:
  void fit(int nodes) {
    if (static_cast<int>(spot_.size()) < nodes) spot_.resize(nodes, -1);
  }
  bool empty() const { return heap_.empty(); }
  bool holds(int node) const { return spot_[node] >= 0; }
  int top() const { return heap_.front().node; }
  std::int32_t gain() const { return heap_.front().gain; }

  // Change the gain of a node that it holds.
  void add(int node, std::int32_t gain) { set(node, heap_[spot_[node]].gain + gain); }

  // Add a node, or change its gain.
  void set(int node, std::int32_t gain) {
    std::int32_t at = spot_[node];
    if (at < 0) {
      at = static_cast<std::int32_t>(heap_.size());
      heap_.push_back({gain, node});
      rise(at, {gain, node});
    } else if (gain > heap_[at].gain) {
      rise(at, {gain, node});
    } else if (gain < heap_[at].gain) {
      sink(at, {gain, node});
    }
  }

  void remove(int node) {
    const std::int32_t at = spot_[node];
    if (at < 0) return;
    spot_[node] = -1;
    const Entry last = heap_.back();
    heap_.pop_back();
    if (last.node == node) return;
    if (at > 0 && heap_[(at - 1) / kArms].gain < last.gain) rise(at, last);
    else sink(at, last);
  }

  void clear() {
    for (const Entry& entry : heap_) spot_[entry.node] = -1;
    heap_.clear();
  }

 private:
  static constexpr std::int32_t kArms = 4;
  struct Entry {
    std::int32_t gain, node;
  };

  void put(std::int32_t at, Entry entry) {
    heap_[at] = entry;
    spot_[entry.node] = at;
  }
  void rise(std::int32_t at, Entry entry) {
    while (at > 0) {
      const std::int32_t above = (at - 1) / kArms;
      if (heap_[above].gain >= entry.gain) break;
      put(at, heap_[above]);
      at = above;
    }
    put(at, entry);
  }
  void sink(std::int32_t at, Entry entry) {
    const auto size = static_cast<std::int32_t>(heap_.size());
    while (true) {
      const std::int32_t first = kArms * at + 1;
      if (first >= size) break;
      std::int32_t best = first;
      for (std::int32_t i = first + 1; i < first + kArms && i < size; ++i) {
        if (heap_[i].gain > heap_[best].gain) best = i;
      }
      if (heap_[best].gain <= entry.gain) break;
      put(at, heap_[best]);
      at = best;
    }
    put(at, entry);
  }

  std::vector<Entry> heap_;
  std::vector<std::int32_t> spot_;  // node -> where it stands, -1
};

}  // namespace poise::cut
