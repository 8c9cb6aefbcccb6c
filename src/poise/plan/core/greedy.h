// The paper's greedy: the mirror of ../greedy.py, decision for decision.
#pragma once

#include <memory>

#include "greedy_few.h"
#include "problem.h"

namespace poise {

// Its tables are kept between runs: at 24 units, allocating costs more than deciding.
class Greedy {
 public:
  explicit Greedy(const Problem& problem);

  // Place every unit in turn; false at the first that fits nowhere, which stays at -1
  // with all after it.
  bool run(Placement& placed);

 private:
  // What placing a unit needs to know of one resource's residues.
  struct Balance {
    double low, high, second;  // smallest, largest and second largest residue
    int highest;               // the computer with the largest
    double sum, squares;       // of the residues, less `centre`
    double centre;
  };

  void start();
  void weigh(int unit, const Placement& placed);
  void weigh_connectors(int unit, const Placement& placed);
  void weigh_range(int resource, double need);
  void weigh_variance(int resource, double need);
  void close(int unit, const Placement& placed);
  int best() const;
  void pay(int unit, int computer, const Placement& placed);
  void use(int unit, int computer);
  void scan(int resource);

  const Problem& p_;
  std::unique_ptr<FewGreedy> few_;  // which then does it all
  std::vector<double> first_share_;  // (r, m) with nothing placed
  std::vector<double> left_, share_;  // (r, m)
  std::vector<double> total_;         // (m): F with the unit there
  std::vector<Balance> balance_, first_balance_;
  std::vector<double> traffic_;       // (m, m), when bandwidth is limited
  double paid_ = 0;                   // communication and linear cost so far
};

}  // namespace poise
