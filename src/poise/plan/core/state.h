// A placement under search, with everything kept that makes a search move cheap to weigh.
#pragma once

#include <vector>

#include "times.h"

namespace poise {

// The largest or smallest three residues of a resource: enough to know the extreme of
// all computers but two in no time.
struct Extremes {
  double value[3];
  int computer[3];
  double without(int a, int b) const {
    for (int i = 0; i < 2; ++i) {
      if (computer[i] != a && computer[i] != b) return value[i];
    }
    return value[2];
  }
};

// What a search move would change.
struct Change {
  double objective = 0;  // F
  double excess = 0;     // by how much limits are broken, in shares of a mean limit
};

using Units = std::vector<std::int32_t>;

class State {
 public:
  explicit State(const Problem& problem);

  void reset(const Placement& placed);

  const Placement& placed() const { return placed_; }
  int at(int unit) const { return placed_[unit]; }
  const std::vector<std::int32_t>& on(int computer) const { return on_[computer]; }
  double objective() const { return paid_ + loads(); }
  // The parts of F that cannot fall below nothing.
  double loads() const { return balance_ + shortage_ + time_.paid; }
  double excess() const { return excess_ + over_links_ + conflicts_ + time_.excess; }
  bool feasible() const {
    return excess_ <= 0 && overfull_ == 0 && conflicts_ == 0 && time_.broken == 0;
  }

  // Weigh a search move: `out` leaves `a` for `b`, `back` leaves `b` for `a`; either may
  // be empty. `weigh_paid` gives the part of communication and linear cost alone, quickly.
  Change weigh(const Units& out, const Units& back, int a, int b);
  double weigh_paid(const Units& out, const Units& back, int a, int b);
  Change weigh_rest(const Units& out, const Units& back, int a, int b);
  void apply(const Units& out, const Units& back, int a, int b);

  // What `unit` pays for connectors and linear cost on `computer`, the others as they are.
  double pays(int unit, int computer) const {
    if (!table_.empty()) return table_[static_cast<std::size_t>(unit) * p_.m + computer];
    double total = 0;
    for (const Neighbour& other : p_.neighbours(unit)) {
      total += placed_[other.unit] == computer ? 0.0 : other.overhead;
    }
    return total;
  }
  double left(int resource, int computer) const {
    return left_[static_cast<std::size_t>(resource) * p_.m + computer];
  }

  // What the residues of a resource come to on all computers but two: their extremes
  // (range), or sum and squares, less `centre`, and as `high` the number of all (variance).
  struct Others {
    double high, low, sum, squares, centre;
  };
  Others others(int resource, int a, int b) const;

 private:
  void reset_table();
  Change weigh_loads(int a, int b);
  void find_extremes(int resource);
  void shift(int unit, int to);
  void settle(int a, int b);
  double over(int computer) const;
  double shortage(int computer) const;
  double balance_now() const;
  int conflicts_with(const Units& out, const Units& back, int a, int b);
  double link_excess(const Units& out, const Units& back, int a, int b);
  double shift_traffic(int unit, int to);

  const Problem& p_;
  Placement placed_;
  std::vector<std::vector<std::int32_t>> on_;  // computer -> its units
  std::vector<std::int32_t> spot_;             // unit -> where it stands in there
  std::vector<double> table_;  // (n, m): see `pays`; empty on many computers all alike far
  std::vector<double> left_;                   // (r, m)
  std::vector<double> share_of_limit_;         // (r): 1 / mean limit
  std::vector<Extremes> high_, low_;           // (r)
  std::vector<double> sum_, squares_, centre_;  // (r): for the variance
  std::vector<double> need_;                   // (r): what a move takes from a to b
  std::vector<char> mark_;                     // (n): 1 in `out`, 2 in `back`
  std::vector<double> traffic_;                // (m, m)
  std::optional<Times> times_;                 // where there are time limits
  TimeSum time_;                               // what these come to
  double paid_ = 0, balance_ = 0, shortage_ = 0, excess_ = 0, over_links_ = 0;
  int conflicts_ = 0;  // pairs that must be apart and are not
  int overfull_ = 0;   // links; `over_links_` is a sum of many steps, and not exact
};

}  // namespace poise
