#include "tree.h"

#include <algorithm>
#include <cmath>

namespace poise {

Tree::Tree(const Problem& problem)
    : p_(problem), n_(p_.n), m_(p_.m), r_(p_.r), at_(p_.n) {
  for (int i = 0; i < n_; ++i) possible_ &= p_.choices(i) > 0;
}

Outcome Tree::run(const Placement& known, Stop& stop) {
  Outcome out;
  if (possible_) {
    stop_ = &stop;
    best_placed_.clear();
    open_bound_ = kInfinity;
    set_best(kInfinity);
    if (!known.empty()) {
      best_placed_ = known;
      set_best(terms(p_, known).total());
    }
    descend();
    out.placed = best_placed_;
  }
  out.proven = !stop.stopped();
  out.bound = out.proven ? best_ : std::min(best_, open_bound_);
  const bool none = out.placed.empty() && n_ > 0;
  out.reason = !out.proven ? stop.reason() : none ? Reason::kInfeasible : Reason::kProven;
  out.steps = stop.steps();
  return out;
}

void Tree::set_best(double objective) {
  best_ = objective;
  const bool known = objective < kInfinity;
  threshold_ = known ? objective - 1e-11 * (1.0 + std::fabs(objective)) : kInfinity;
}

void Tree::found() {
  Placement placed(n_);
  for (int d = 0; d < n_; ++d) placed[order_[d]] = at_[d];
  const double total = terms(p_, placed).total();
  if (total >= threshold_) return;
  // What links carry was added and taken away step by step, and rounded at each.
  const bool sums = !p_.bandwidth.empty() || p_.time_limits;
  if (sums && !feasible(p_, placed)) return;
  set_best(total);
  best_placed_ = std::move(placed);
}

}  // namespace poise
