// The greedy on two to eight computers.
#pragma once

#include "problem.h"

namespace poise {

class FewGreedy {
 public:
  static bool takes(const Problem& problem);

  explicit FewGreedy(const Problem& problem);

  // As `Greedy::run`.
  bool run(Placement& placed);

 private:
  struct Tie {  // a connector to a unit that is placed before
    std::int32_t step;
    double overhead;
  };
  int decide_all();
  template <int M>
  int run_on();
  template <int M, int R, bool kVariance>
  int decide();
  template <int M, bool kVariance>
  static void weigh(const double* now, const double* then, double* total);
  template <int M>
  static int first_of(const double* total);

  const Problem& p_;
  std::vector<std::uint32_t> ties_from_;  // (n + 1), in the order of placing
  std::vector<Tie> ties_;
  std::vector<double> cost_;  // (n, m): linear, infinite where it may not run
  std::vector<double> need_;  // (n, r)
  std::vector<double> factor_;  // (r, m): residue -> weighed share
  std::vector<double> room_, share_;  // (r, m): what may still be used; weighed residue
  std::vector<std::int32_t> at_;  // (n): computer, by step
};

}  // namespace poise
