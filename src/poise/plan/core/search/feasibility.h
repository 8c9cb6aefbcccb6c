// A placement that keeps the limits, whatever its F: for robots so full that few do.
#pragma once

#include <vector>

#include "problem/problem.h"
#include "problem/random.h"
#include "problem/stop.h"

namespace poise {

// A local search over how far capacities are exceeded. A search move takes a dozen units
// of two computers and tries every way to share them out between the two; all else stays.
// What is exceeded for long becomes dearer, which drives the excess elsewhere. Units that
// must be apart change sides together, so that what is apart stays apart. The bandwidth of
// links is not looked at.
class Feasibility {
 public:
  Feasibility(const Problem& problem, Stop& stop, Random& random);

  // The first placement found that fits, or the one left when it is time to stop; empty
  // when a unit may run nowhere.
  Placement run();

 private:
  // Units that change sides together, in `chained_`.
  struct Element {
    std::size_t first, last;
  };

  bool fill();
  double worth(int unit, int computer) const;
  int most_fitting(int unit) const;
  void put(int unit, int computer);
  void take(int unit);
  void weigh(int computer);
  void raise();
  bool split();
  void gather(int a, int b);
  bool chain(int unit, int a, int b);
  void choose(int a);
  void sum_up(int a);
  std::size_t least_exceeding(int a, int b, double now);
  void flip(std::size_t subset, int a, int b);

  const Problem& p_;
  Stop& stop_;
  Random& random_;
  const int r_;
  std::vector<double> need_;                 // (n, r), in mean limits, as all loads are
  std::vector<double> room_, load_, price_;  // (m, r)
  Placement placed_;
  std::vector<std::vector<std::int32_t>> on_;  // computer -> its units
  std::vector<std::int32_t> spot_;             // unit -> where it stands in there
  std::vector<double> over_;                   // (m): what is exceeded, priced
  std::vector<std::int32_t> broken_;           // computers over a limit
  std::vector<std::int32_t> broken_spot_;      // computer -> where it stands there, or -1

  // The two computers at hand.
  std::vector<Element> elements_;
  std::vector<std::int32_t> chained_;
  std::vector<std::uint32_t> seen_;  // unit -> the last round in which it was chained
  std::uint32_t round_ = 0;
  std::vector<double> shift_;       // (elements, r): what flipping one adds to a's load
  std::vector<double> low_, high_;  // (r, subsets): sums of shifts; `high_` with a's load
  std::vector<double> excess_;      // (subsets)
};

}  // namespace poise
