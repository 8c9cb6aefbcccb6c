// Iterated local search: shake the placement a little, then repartition pairs of computers.
#include <algorithm>
#include <utility>

#include "search.h"

namespace poise {
namespace {

constexpr int kMostShakes = 2;
// Branch and bound on two computers takes some 500 nodes to prove its best; what it has
// not found after twice as many it hardly ever finds.
constexpr int kNodes = 1000;
// How often it is shaken in vain, for each pair of computers, before it is given up for
// another cooling.
constexpr std::int64_t kPatience = 8;
// Over more computers than these not every pair is looked at.
constexpr int kManyComputers = 64;

}  // namespace

// A computer has changed: share out anew what it holds with each other one; of many only
// with those that its units are connected to, and with any one besides.
void Search::touch(int h) {
  const auto add = [&](int g) {
    if (g != h) stale_.emplace_back(std::max(g, h), std::min(g, h));
  };
  if (p_.m <= kManyComputers) {
    for (int g = 0; g < p_.m; ++g) add(g);
    return;
  }
  for (const std::int32_t unit : state_.on(h)) {
    for (const Neighbour& other : p_.neighbours(unit)) add(state_.at(other.unit));
  }
  add(random_.below(p_.m));
}

// Share out pairs of computers until none of them can be improved.
void Search::repartition_pairs() {
  bool touched = true;
  while (!stop_.stopped() && !stale_.empty()) {
    if (touched) {
      std::sort(stale_.begin(), stale_.end());
      stale_.erase(std::unique(stale_.begin(), stale_.end()), stale_.end());
    }
    const int i = random_.below(static_cast<int>(stale_.size()));
    const auto [a, b] = stale_[i];
    stale_.erase(stale_.begin() + i);
    touched = repartition_.run(state_, a, b, kNodes, stop_);
    if (!touched) continue;
    touch(a);
    touch(b);
    stale_.erase(std::remove(stale_.begin(), stale_.end(), std::make_pair(a, b)),
                 stale_.end());
  }
}

void Search::shake() {
  for (int i = 1 + random_.below(kMostShakes); i > 0; --i) {
    if (!propose()) continue;
    state_.apply(move_.out, move_.back, move_.a, move_.b);
    touch(move_.a);
    touch(move_.b);
  }
}

void Search::local_search() {
  state_.reset(best_);
  for (int h = 0; h < p_.m; ++h) touch(h);
  repartition_pairs();
  if (state_.feasible()) offer(state_.placed());
  Placement here = best_;
  double now = best_objective_;
  const std::int64_t most = kPatience * p_.m * p_.m;
  for (std::int64_t idle = 0; idle < most && !stop_.after(1); ++idle) {
    shake();
    repartition_pairs();
    const double next = state_.feasible() ? state_.objective() : kInfinity;
    if (next < best_objective_ - 1e-12) offer(state_.placed());
    if (next <= now) {
      if (next < now - 1e-12) idle = 0;
      now = next;
      here = state_.placed();
    } else {
      state_.reset(here);
    }
  }
}

}  // namespace poise
