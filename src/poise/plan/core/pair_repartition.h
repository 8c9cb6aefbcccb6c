// The largest search move: share out all units of two computers between them, anew and
// as well as possible, while everything else stays.
#pragma once

#include <vector>

#include "state.h"
#include "stop.h"

namespace poise {

// Branch and bound over the units of two computers: with a few dozen units it takes microseconds. It starts from how they are
// shared out now, so that it can only improve, and gives up after some nodes.
class PairRepartition {
 public:
  explicit PairRepartition(const Problem& problem);

  // Whether `state` was improved. Limits that are broken now count as infinitely bad; what
  // the links carry is looked at only in the end.
  bool run(State& state, int a, int b, int most_nodes, Stop& stop);

 private:
  struct Tie {
    std::int32_t depth;
    double overhead;
  };
  struct Resource {
    double left[2], floor[2], goal[2], scale[2], size[2];
    // Of all other computers. Range: their extremes. Variance: `high` is the number of
    // computers that are counted, these two among them.
    double high, low;
    double sum, squares, centre;
    double weight;
    bool even;  // both have the resource
  };

  bool collect(const State& state, int a, int b);
  void take_off(const State& state);
  void weigh_resources(const State& state, int a, int b);
  void sort_units(int a, int b);
  void connect(const State& state, int a, int b);
  void open(int depth);
  void enter(int depth, int side);
  double bound(int depth, int side) const;
  void add_times(int depth, double* bounds);
  double imbalance(int depth, int side) const;
  double spread(const Resource& resource, double a, double b, double open) const;
  double spread_of_one(const Resource& resource, double share, double open) const;
  void weigh_pulls();
  bool fits(int depth, int side) const;
  // Whether time limits hold, and what is beyond them is not too much besides `least`.
  bool in_time(double least) const {
    return time_.broken <= late_ && least + time_.paid < best_total_;
  }
  void place(int depth, int side);
  void unplace(int depth, int side);

  const Problem& p_;
  int r_, count_ = 0, nodes_ = 0, most_nodes_ = 0;
  std::vector<std::int32_t> units_;  // by depth
  std::vector<std::int32_t> depth_of_;  // unit -> depth, -1
  std::vector<signed char> now_, side_, best_;
  std::vector<signed char> forced_;  // the only side allowed, or -1
  std::vector<double> value_;
  std::vector<Tie> ties_;
  std::vector<std::size_t> tie_start_;
  std::vector<double> need_, open_, base_, pull_, saved_pull_;
  std::vector<Resource> resources_;
  double followed_ = 0, pulling_ = 0, best_total_ = 0;
  bool improved_ = false;
  std::optional<Times> times_;  // with none of the units but those in the tree so far
  TimeSum time_;                // what these come to
  bool timed_ = false;          // some unit has a part in a time limit
  int late_ = 0;                // limits that are broken without them
  int sides_[2] = {0, 0};       // the computers
};

}  // namespace poise
