// The greedy on two to eight computers. Their number known, the compiler unrolls every
// loop over them; the balance is recomputed rather than kept, and what a unit finds
// placed already is listed beforehand. Several times as fast.
#include "greedy_few.h"

#include <algorithm>
#include <cmath>

#include "wide.h"

namespace poise {

bool FewGreedy::takes(const Problem& p) {
  bool whole = true;  // every computer has every resource whose balance is weighed
  for (int k = 0; k < p.r; ++k) whole &= p.weight[k] <= 0 || p.counted[k] == p.m;
  return whole && p.m >= 2 && p.m <= 8 && p.bandwidth.empty() && p.distance.empty() &&
         !p.has_apart();
}

FewGreedy::FewGreedy(const Problem& problem) : p_(problem), at_(p_.n) {
  std::vector<std::int32_t> step_of(p_.n);
  for (int i = 0; i < p_.n; ++i) step_of[p_.order[i]] = i;
  ties_from_.assign(1, 0);
  for (int i = 0; i < p_.n; ++i) {
    const int unit = p_.order[i];
    for (const Neighbour& other : p_.neighbours(unit)) {
      if (step_of[other.unit] < i) ties_.push_back({step_of[other.unit], other.overhead});
    }
    ties_from_.push_back(static_cast<std::uint32_t>(ties_.size()));
    for (int h = 0; h < p_.m; ++h) {
      cost_.push_back(p_.allowed(unit, h) ? p_.linear(unit, h) : kInfinity);
    }
    for (int k = 0; k < p_.r; ++k) need_.push_back(p_.demand[unit * p_.r + k]);
  }
  for (int k = 0; k < p_.r; ++k) {
    // So that the range, or the sum of squares, comes out with its weight.
    const double weight = p_.variance ? std::sqrt(p_.weight[k] / p_.m) : p_.weight[k];
    for (int h = 0; h < p_.m; ++h) factor_.push_back(weight * p_.scale[k * p_.m + h]);
  }
  room_.resize(p_.capacity.size());
  share_.resize(p_.capacity.size());
}

bool FewGreedy::run(Placement& placed) {
  const int reached = decide_all();
  placed.resize(p_.n);
  for (int i = 0; i < p_.n; ++i) placed[p_.order[i]] = i < reached ? at_[i] : -1;
  return reached == p_.n;
}

POISE_WIDE // How many units were placed, in the problem's order.
POISE_WIDE int FewGreedy::decide_all() {
  switch (p_.m) {
    case 2: return run_on<2>();
    case 3: return run_on<3>();
    case 4: return run_on<4>();
    case 5: return run_on<5>();
    case 6: return run_on<6>();
    case 7: return run_on<7>();
    default: return run_on<8>();
  }
}

template <int M>
POISE_INLINE int FewGreedy::run_on() {
  if (p_.r == 1) return p_.variance ? decide<M, 1, true>() : decide<M, 1, false>();
  if (p_.r == 2) return p_.variance ? decide<M, 2, true>() : decide<M, 2, false>();
  return p_.variance ? decide<M, 0, true>() : decide<M, 0, false>();
}

// Place units in turn; how many were placed. R is the number of resources, 0: any. Each
// decision waits for the one before it, so what counts is how long that chain is.
template <int M, int R, bool kVariance>
POISE_INLINE int FewGreedy::decide() {
  const int r = R > 0 ? R : p_.r;
  double few_room[R > 0 ? R * M : 1], few_share[R > 0 ? R * M : 1];
  double* room = R > 0 ? few_room : room_.data();
  double* share = R > 0 ? few_share : share_.data();
  for (int e = 0; e < r * M; ++e) {
    room[e] = p_.capacity[e] - p_.floor[e];
    share[e] = p_.capacity[e] * factor_[e];
  }
  double paid = 0;
  for (int i = 0; i < p_.n; ++i) {
    double cost[M], total[M];
    for (int h = 0; h < M; ++h) cost[h] = cost_[static_cast<std::size_t>(i) * M + h];
    for (std::uint32_t e = ties_from_[i]; e < ties_from_[i + 1]; ++e) {
      const int there = at_[ties_[e].step];
      for (int h = 0; h < M; ++h) cost[h] += there == h ? 0.0 : ties_[e].overhead;
    }
    for (int h = 0; h < M; ++h) total[h] = paid + cost[h];
    const double* need = need_.data() + static_cast<std::size_t>(i) * r;
    for (int k = 0; k < r; ++k) {
      double then[M];
      for (int h = 0; h < M; ++h) then[h] = share[k * M + h] - need[k] * factor_[k * M + h];
      weigh<M, kVariance>(share + k * M, then, total);
    }
    for (int k = 0; k < r; ++k) {
      for (int h = 0; h < M; ++h) {
        total[h] = room[k * M + h] < need[k] ? kInfinity : total[h];
      }
    }
    const int best = first_of<M>(total);
    if (best < 0) return i;
    at_[i] = best;
    paid += cost[best];
    for (int k = 0; k < r; ++k) {
      for (int h = 0; h < M; ++h) {
        const double used = h == best ? need[k] : 0.0;
        room[k * M + h] -= used;
        share[k * M + h] -= used * factor_[k * M + h];
      }
    }
  }
  return p_.n;
}

// Add the spread of the shares for each place that the unit may take.
template <int M, bool kVariance>
POISE_INLINE void FewGreedy::weigh(const double* now, const double* then, double* total) {
  if (kVariance) {
    double mean = 0, squares = 0;
    for (int h = 0; h < M; ++h) mean += now[h] / M;
    for (int h = 0; h < M; ++h) squares += (now[h] - mean) * (now[h] - mean);
    for (int h = 0; h < M; ++h) {
      const double change = then[h] - now[h];
      total[h] += squares + change * (change * (M - 1) / M + 2 * (now[h] - mean));
    }
  } else if (M == 2) {
    total[0] += std::fabs(then[0] - now[1]);
    total[1] += std::fabs(now[0] - then[1]);
  } else {
    double low = now[0], high = now[0], second = -kInfinity;
    for (int h = 1; h < M; ++h) {
      second = std::max(second, std::min(high, now[h]));
      high = std::max(high, now[h]);
      low = std::min(low, now[h]);
    }
    for (int h = 0; h < M; ++h) {
      // Where the share is the largest, it may no longer be once the unit is there.
      const double top = now[h] == high ? std::max(second, then[h]) : high;
      total[h] += top - std::min(low, then[h]);
    }
  }
}

// The first computer whose F is lowest, within rounding; -1 when none is finite.
template <int M>
POISE_INLINE int FewGreedy::first_of(const double* total) {
  double lowest = total[0];
  for (int h = 1; h < M; ++h) lowest = std::min(lowest, total[h]);
  if (lowest == kInfinity) return -1;
  const double near = lowest + 1e-12 * std::max(1.0, std::fabs(lowest));
  int best = M - 1;
  for (int h = M - 2; h >= 0; --h) best = total[h] <= near ? h : best;
  return best;
}

}  // namespace poise
