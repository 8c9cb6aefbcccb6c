// Branch and bound on two computers when few connectors join what is placed to what is
// open: the paper's own case, and the fastest.
#pragma once

#include "tree.h"

namespace poise {

// Sub-architectures have few connectors between them. In a good order, all that the open
// units know of the placed ones is where a handful of these are: the frontier. So there
// are few states: a depth, and a placement of its frontier. A table says for each state
// what the open units must still cost at least, connectors among them included, if an
// imbalance had a certain price. What imbalance truly costs is never less than the price
// times the imbalance, less a constant of that price, for whichever price; so the largest
// such sum is a bound. At the root it is hardly ever below the optimum by more than what
// the last few units cannot level out.
class FrontierTree final : public Tree {
 public:
  static constexpr int kMostWeighed = 3;

  static bool takes(const Problem& problem);

  explicit FrontierTree(const Problem& problem);

  // Whether the frontier is narrow enough for the tables; else do not run this tree.
  bool narrow() const { return narrow_; }

 private:
  struct Depth {  // of units that have a choice
    std::uint32_t start;  // its first state
    std::uint32_t bit;    // of the unit in the frontier's placement, or 0
    std::uint32_t keep;   // the bits of the frontier once the unit is placed
  };
  struct State {
    double cost[2];        // of the unit on either side: linear, and to placed units
    std::uint32_t next[2];
  };
  struct Weighed {  // a resource whose balance has a weight
    int resource;
    double weight;
    double first;  // residue of computer 0 less that of 1, if open units were halved
  };

  bool sort_units();
  bool count_states();
  std::uint32_t most_states() const { return 256 * static_cast<std::uint32_t>(n_); }
  void settle_forced();
  void set_prices();
  void fill_tables();
  void fill_costs(int depth, std::uint32_t count);
  void fill_least(int depth, const State& state, double* least) const;

  void descend() override;
  template <int R>
  void open(int depth, std::uint32_t state, double paid);
  template <int R>
  double bound(int depth, std::uint32_t next, int side) const;
  bool fits(int depth, int side) const;
  void place(int depth, int side);

  bool narrow_ = false, twins_ = false, holds_ = true;
  int forced_ = 0, free_ = 0;         // units with one choice, which come first; others
  std::vector<std::int32_t> depth_of_;  // unit -> place among the free, or -1
  std::vector<Depth> depths_;         // (free + 1)
  std::vector<State> states_;
  std::vector<Weighed> weighed_;
  int prices_ = 0;                    // a multiple of 4
  std::vector<double> price_;         // (weighed, prices)
  std::vector<double> constant_;      // (prices)
  std::vector<double> least_;         // (states, prices)
  std::vector<double> half_;          // (free, weighed): what a unit's place adds to `off_`
  std::vector<double> need_;          // (free, r)
  std::vector<double> tilt_;          // (free, prices): `half_`, priced
  std::vector<double> apart_;         // scratch of `fill_costs`
  double forced_cost_ = 0;

  std::vector<double> off_;           // (free + 1, weighed): `first`, with what is placed
  std::vector<double> left_;          // (free + 1, r, 2)
};

}  // namespace poise
