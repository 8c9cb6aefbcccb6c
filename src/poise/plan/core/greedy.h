// The paper's greedy: the mirror of ../greedy.py, decision for decision.
#pragma once

#include "problem.h"

namespace poise {

// Its tables are kept between runs: at 24 units, allocating costs more than deciding.
//
// Over many computers that are alike, most have room for a unit without becoming the
// fullest, and F is the same on all of them. So computers stand in blocks of which the
// largest residues are known: what F would be with those is a lower bound of F on the
// whole block, and a block whose bound is no better than what was found is left out.
class Greedy {
 public:
  explicit Greedy(const Problem& problem);

  // Place every unit in turn; false at the first that fits nowhere, which stays at -1
  // with all after it.
  bool run(Placement& placed);

  // What placing a unit needs to know of one resource's residues.
  struct Balance {
    double low, high, second;     // smallest, largest and second largest share
    double sum, squares, centre;  // of the shares, less `centre`
    double weight, part;          // part: 1 / how many computers are counted
  };

 private:
  struct Tie {  // a connector to a unit that is placed
    std::int32_t computer;
    double overhead, traffic;
  };

  void start();
  int decide(int unit, const Placement& placed);
  void gather(int unit, const Placement& placed);
  void weigh(const double* need, int count, double* total, const double* share,
             const double* room, const double* scale, int stride) const;
  int best_of_all(int unit);
  int best_of_blocks(const double* need);
  void weigh_block(const double* need, int block);
  void shut(int unit);
  void shut_full_links();
  void pay(int unit, int computer);
  void use(const double* need, int computer);
  void find_block(int resource, int block);
  void find_high(int resource);

  const Problem& p_;
  int blocks_ = 0;                    // 0: every computer is always weighed
  std::vector<double> first_share_;   // (r, m) with nothing placed
  std::vector<double> share_, room_;  // (r, m): residue; what of it may still be used
  std::vector<double> total_;         // (m): F with the unit there
  std::vector<double> extra_;         // (m): what the unit pays there besides `all_`
  std::vector<Balance> balance_, first_balance_;
  std::vector<double> traffic_;       // (m, m), when bandwidth is limited
  std::vector<Tie> ties_;             // of the unit
  double paid_ = 0;                   // communication and linear cost so far
  double all_ = 0;                    // that, with every tie of the unit paid for

  // Of blocks of computers, when there are any.
  std::vector<double> top_, second_, top_room_;  // (r, blocks): the largest in there
  std::vector<double> bound_;     // (blocks): no total in there is lower
  std::vector<double> least_;     // (blocks): the lowest total; infinite: not weighed
  std::vector<std::int32_t> touched_;  // computers with something in `extra_`
};

}  // namespace poise
