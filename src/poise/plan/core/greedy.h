// The paper's greedy, as tests/plan/reference/greedy.py specifies it.
#pragma once

#include "times.h"

namespace poise {

// Its arrays are kept between runs: at 24 units, allocating costs more than deciding.
class Greedy {
 public:
  explicit Greedy(const Problem& problem);

  // Place every unit in turn; false at the first that fits nowhere, which stays at -1
  // with all after it.
  bool run(Placement& placed);

 private:
  // What placing a unit needs to know of one resource's residues.
  struct Balance {
    double low, high, second;     // smallest, largest and second largest share
    double sum, squares, centre;  // of the shares, less `centre`
  };
  struct Tie {  // a connector to a unit that is placed
    std::int32_t computer;
    double overhead, traffic;
  };

  Span<Tie> ties() const { return {ties_.data(), ties_.data() + tie_count_}; }
  void start();
  void pay_for_ties(int unit, const Placement& placed);
  void add_balance(int resource, double need);
  void add_shortage(int resource, double need);
  void shut(int unit, const Placement& placed);
  void shut_full_links();
  void add_times(int unit);
  int best() const;
  void put(int unit, int computer);
  void find_extremes(int resource);

  const Problem& p_;
  std::vector<double> first_share_;   // (r, m) with nothing placed
  std::vector<double> share_, room_;  // (r, m): residue; what of it may still be used
  std::vector<double> over_goal_;     // (r, m): residue beyond the goal, where priced
  std::vector<double> total_;         // (m): F with the unit there
  std::vector<Balance> balance_, first_balance_;
  std::vector<double> traffic_;       // (m, m), when bandwidth is limited
  std::optional<Times> times_;        // where there are time limits
  std::vector<Tie> ties_;             // of the unit, the first `tie_count_`
  int tie_count_ = 0;
  double paid_ = 0;                   // communication and linear cost so far
};

}  // namespace poise
