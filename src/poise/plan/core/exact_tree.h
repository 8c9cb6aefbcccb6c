// What branch and bound keeps on its way down and up the tree.
#pragma once

#include <vector>

#include "exact.h"
#include "shift.h"

namespace poise {

// What every branch and bound keeps: the order of the units and the best placement so far.
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

// A tree whose units come by their ties and sizes, and what is known of each depth. It
// does not depend on the number of computers known to the compiler.
class OrderedTree : public Exact::Tree {
 public:
  explicit OrderedTree(const Problem& problem);

 protected:
  struct Later {  // a connector to a unit that is deeper in the tree
    int depth;
    std::size_t table;  // where its costs start in `PairCosts::pair`
  };
  struct Branch {
    int computer;
    double bound;
  };

  void start();
  bool apart_fits(int depth, int computer) const;
  bool send(int depth, int computer, double sign);

  std::vector<std::int32_t> depth_of_;    // unit -> depth
  std::vector<std::size_t> later_start_;  // (n + 1)
  std::vector<Later> later_;
  std::vector<double> need_;   // (n, r) by depth
  std::vector<double> open_;   // (n + 1, r): demand from a depth on
  std::vector<double> final_;  // (r): residue of all computers together at the end
  std::vector<double> width_;  // (r): capacity of all computers together, or their number
  std::vector<double> size_;   // (r, m): what a unit of share is of the resource
  PairCosts costs_;            // by depth, as shifted
  std::vector<int> twin_;      // (m): the computer before it that is just like it, or -1
  std::vector<char> alike_;    // (r): residue is measured alike on all computers

  // What changes from node to node.
  std::vector<double> unary_;   // (n, m) by depth: towards placed units, and linear
  std::vector<double> least_;   // (n): the smallest of each row
  std::vector<double> saved_;   // (later, m + 1): rows and `least_` as they were
  std::vector<double> left_;    // (r, m)
  std::vector<double> traffic_; // (m, m), of a larger and a smaller index
  std::vector<int> units_on_;   // (m)
  std::vector<Branch> branch_;  // (n, m)
  double paid_ = 0, least_sum_ = 0;

 private:
  void sort_units();
  void connect();
  void find_twins();
  void price();
  void measure();
};

}  // namespace poise
