// Climbing: shake the placement a little, then share out every two computers anew.
#include <algorithm>
#include <utility>

#include "search.h"

namespace poise {
namespace {

constexpr int kMostShakes = 2;
// Branch and bound on two computers takes some 500 nodes to prove its best; what it has
// not found after twice as many it hardly ever finds.
constexpr int kNodes = 1000;

}  // namespace

void Search::touch(int h) {
  for (int g = 0; g < p_.m; ++g) {
    if (g != h) stale_[static_cast<std::size_t>(std::max(g, h)) * p_.m + std::min(g, h)] = 1;
  }
}

// Share out pairs of computers until none of them can be improved.
void Search::resplit_all() {
  std::vector<std::pair<int, int>> pairs;
  while (!stop_.stopped()) {
    pairs.clear();
    for (int a = 0; a < p_.m; ++a) {
      for (int b = 0; b < a; ++b) {
        if (stale_[static_cast<std::size_t>(a) * p_.m + b]) pairs.emplace_back(a, b);
      }
    }
    if (pairs.empty()) return;
    const auto [a, b] = pairs[random_.below(static_cast<int>(pairs.size()))];
    if (resplit_.run(state_, a, b, kNodes, stop_)) {
      touch(a);
      touch(b);
    }
    stale_[static_cast<std::size_t>(a) * p_.m + b] = 0;
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

// `patience`: how often, for each pair of computers, it is shaken in vain before it is
// given up for another cooling.
void Search::climb(int patience) {
  state_.reset(best_);
  for (int h = 0; h < p_.m; ++h) touch(h);
  resplit_all();
  if (state_.feasible()) offer(state_.placed());
  Placement here = best_;
  double now = best_objective_;
  const std::int64_t most = static_cast<std::int64_t>(patience) * p_.m * p_.m;
  for (std::int64_t idle = 0; idle < most && !stop_.after(1); ++idle) {
    shake();
    resplit_all();
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
