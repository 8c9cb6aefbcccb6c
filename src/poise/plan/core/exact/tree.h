// What every branch and bound keeps: the order of the units and the best placement so far.
#pragma once

#include "exact/exact.h"

namespace poise {

class Exact::Tree {
 public:
  explicit Tree(const Problem& problem);
  virtual ~Tree() = default;

  Outcome run(const Placement& known, Stop& stop);

 protected:
  // Go through the tree from its root; where `stop_` says so, leave it with the least
  // bound of what was not looked at in `open_bound_`.
  virtual void descend() = 0;

  void found();
  void set_best(double objective);

  const Problem& p_;
  Stop* stop_ = nullptr;
  int n_, m_, r_;
  std::vector<std::int32_t> order_;  // depth -> unit
  std::vector<std::int32_t> at_;     // (n) by depth: its computer
  bool possible_ = true;             // every unit may run somewhere
  double best_ = kInfinity, threshold_ = kInfinity, open_bound_ = kInfinity;
  Placement best_placed_;
};

}  // namespace poise
