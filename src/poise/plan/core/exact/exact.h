// Branch and bound: the proven optimum, where that is quick.
#pragma once

#include <memory>

#include "problem/outcome.h"

namespace poise {

// Depth-first over the units, connected ones one after the other. A partial placement is
// given up when what it has paid, plus the least that every open unit must pay towards
// placed ones, plus the imbalance that is left if open demand flowed freely, is no better
// than the best placement known. Prepared once, it may run many times.
class Exact {
 public:
  static constexpr int kMostUnits = 1024, kMostComputers = 64;
  static bool takes(const Problem& problem) {
    return problem.n <= kMostUnits && problem.m <= kMostComputers;
  }

  explicit Exact(const Problem& problem);
  ~Exact();

  // `known` may be empty; else it must be feasible.
  Outcome run(const Placement& known, Stop& stop);

  class Tree;

 private:
  std::unique_ptr<Tree> tree_;
};

}  // namespace poise
