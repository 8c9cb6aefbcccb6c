// How even the residues could be at best, if demand flowed freely between computers.
#pragma once

#include <algorithm>

#include "problem.h"

namespace poise {

// The least spread of one resource on `m` computers. `share` holds their residues in units
// of the spread, `size` what a unit of share is of the resource (0: not counted), and
// `open` the demand that may still flow anywhere. `level` is what all would have if they
// ended level; `alike`: all sizes are equal.
//
// Demand flows where most is left, until that is level with the next, and so on. Then no
// computer has more than a certain level, and the smallest residue cannot rise.
inline double relaxed_spread(const double* share, const double* size, int m, int counted,
                             double level, double open, bool variance, bool alike) {
  double low = kInfinity;
  for (int h = 0; h < m; ++h) low = size[h] > 0 && share[h] < low ? share[h] : low;
  // Begin level on all computers, leave out those that have less, and level again.
  for (;;) {
    double left = -open, width = 0;
    for (int h = 0; h < m; ++h) {
      const bool above = share[h] >= level;
      left += above ? share[h] * size[h] : 0.0;
      width += above ? size[h] : 0.0;
    }
    const double next = width > 0 ? left / width : level;
    if (!(next > level + 1e-12)) break;
    level = next;
  }
  const double range = level - low;
  if (range <= 0) return 0;
  if (!variance) return range;
  // Two residues at this distance and all others midway.
  if (!alike) return range * range / (2.0 * counted);
  double sum = 0, squares = 0;
  for (int h = 0; h < m; ++h) {
    const double off = std::min(share[h], level) - level;
    sum += off;
    squares += off * off;
  }
  return (squares - sum * sum / m) / m;
}

// The least shortage of a priced resource. `left` holds residues, and `open` the demand that
// may still flow anywhere: to where there is room, as far as there is.
inline double relaxed_shortage(const Problem& p, int k, const double* left, double open) {
  double total = 0, room = 0;
  for (int h = 0; h < p.m; ++h) {
    const double over = left[h] - p.goal[static_cast<std::size_t>(k) * p.m + h];
    (over > 0 ? room : total) += over > 0 ? over : -over;
  }
  return total + (open > room ? open - room : 0.0);
}

// How one resource is levelled, whatever is placed where.
struct Levelling {
  Levelling(const Problem& problem, int resource);

  std::vector<double> size;  // (m): what a unit of share is of the resource; 0: not counted
  double level = 0;          // the share of all computers, if they ended level
  bool alike = true;         // all sizes are equal
};

// A number that no placement's F is below: no connector is paid, each unit has its
// cheapest computer, demand flows freely, also into shortages, and each run is alone on
// its fastest computer.
double relaxation_bound(const Problem& problem);

}  // namespace poise
