// The anytime search: one cooling, then local search by the largest moves.
#pragma once

#include <utility>

#include "stop.h"
#include "random.h"
#include "pair_repartition.h"
#include "state.h"

namespace poise {

// Search moves take a unit, or the connected piece of units around it on one computer,
// to another computer, alone or in exchange for a piece from there. Limits are soft while
// cooling: what breaks them has a price that rises while they are broken and falls while
// they hold. Iterated local search then shakes the best placement by a few moves and shares out every
// two computers again (`PairRepartition`), over and over.
class Search {
 public:
  Search(const Problem& problem, Stop& stop, std::uint64_t seed);

  // Keep `placed` as the best if it is better and feasible.
  void offer(const Placement& placed);
  // Search from `start`, which may break limits, until it is time to stop.
  void run(const Placement& start);

  const Placement& best() const { return best_; }

 private:
  struct Move {
    Units out, back;  // `out` leaves `a` for `b`, `back` leaves `b` for `a`
    int a = 0, b = 0;
  };

  bool done() const { return movable_.empty() || p_.m < 2; }
  bool found() const { return !best_.empty(); }

  // annealing.cpp
  bool propose();
  bool follow(int keep);
  void grow(int seed, int to, int keep, Units& piece);
  void calibrate();
  void reprice();
  void note();
  void cool(std::int64_t steps, double heat);
  void try_move(double limit);

  // local_search.cpp
  void local_search();
  void shake();
  void repartition_pairs();
  void touch(int computer);

  const Problem& p_;
  Stop& stop_;
  Random random_;
  State state_;
  PairRepartition repartition_;
  Units movable_;  // units with a choice
  Move move_;
  std::vector<std::uint32_t> seen_;  // the last piece that each unit was gathered for
  std::uint32_t piece_ = 0;
  std::uint64_t dice_ = 0;
  int dice_left_ = 0;
  bool aimless_ = false;  // nothing keeps all limits yet: no weight but what breaks them
  double unit_ = 1;  // by how much F changes with a search move, on average
  double price_ = 0, lowest_price_ = 0;
  double record_ = kInfinity;  // the best F noted while cooling
  Placement noted_;
  std::vector<std::pair<int, int>> stale_;  // pairs of computers to be repartitioned
  Placement best_;
  double best_objective_ = kInfinity;
};

// Search from `known`, or from anywhere when it is empty; never worse than `known`.
Outcome search(const Problem& problem, const Placement& known, Stop& stop,
               std::uint64_t seed);

}  // namespace poise
