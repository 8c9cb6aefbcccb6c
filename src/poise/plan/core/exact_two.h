// Branch and bound on two computers where the frontier (exact_frontier.h) is too wide.
#pragma once

#include "exact_tree.h"

namespace poise {

// With two computers a unit is at +1 or -1, and a connector costs half its overhead times
// (1 - x * y). So all that a unit has to pay towards placed ones is one number, its pull
// towards +1, and the least that all open units must pay is known from the sum of the
// pulls' sizes. A node of the tree costs a dozen nanoseconds.
class TwoTree final : public OrderedTree {
 public:
  static bool takes(const Problem& problem) {
    return problem.m == 2 && problem.bandwidth.empty() && !problem.has_apart();
  }

  explicit TwoTree(const Problem& problem);

 private:
  struct Tie {  // a connector to a unit that is deeper in the tree
    std::int32_t depth;
    double overhead;
  };
  struct Need {  // what one unit asks of one resource, and what is open after it
    double need, open;
  };
  struct Resource {
    double left[2];
    double floor[2], scale[2];
    double weight;
  };

  void descend() override;
  void open(int depth);
  double bound(int depth, int side) const;
  double imbalance(int depth, int side) const;
  bool fits(int depth, int side) const;
  void place(int depth, int side);
  void unplace(int depth, int side);
  void enter(int depth, int side);

  std::vector<Tie> ties_;
  std::vector<std::size_t> tie_start_;
  std::vector<Need> needs_;          // (n, r) by depth
  std::vector<double> first_pull_;   // (n): from linear costs
  std::vector<double> base_;         // (n + 1): half of all that pulls decide over
  std::vector<double> pull_, saved_pull_;
  std::vector<Resource> first_resources_, resources_;
  double followed_ = 0;  // sum of the pulls that placed units followed, less those not
  double pulling_ = 0;   // sum of the pulls' sizes of open units
  int forced_ = 0;       // units with one choice, which come first
  bool twins_ = false;   // the computers are alike
  bool variance_ = false;
};

}  // namespace poise
