// The greedy on two to four computers. Their number known, the compiler unrolls every
// loop over them, and the balance is recomputed rather than kept: three times as fast.
#include <algorithm>
#include <cmath>

#include "greedy.h"

namespace poise {
namespace {

template <int M>
class FewGreedy {
 public:
  FewGreedy(const Problem& problem, const std::vector<double>& first_share,
            std::vector<double>& left, std::vector<double>& share)
      : p_(problem), left_(left), share_(share) {
    left_ = p_.capacity;
    share_ = first_share;
  }

  bool run(Placement& placed) {
    placed.assign(p_.n, -1);
    for (const std::int32_t unit : p_.order) {
      double total[M], cost[M];
      weigh_connectors(unit, placed, cost);
      for (int h = 0; h < M; ++h) total[h] = paid_ + cost[h] + balance(unit, h);
      shut(unit, total);
      double lowest = total[0];
      for (int h = 1; h < M; ++h) lowest = std::min(lowest, total[h]);
      if (lowest == kInfinity) return false;
      const double near = lowest + 1e-12 * std::max(1.0, std::fabs(lowest));
      int best = 0;
      while (!(total[best] <= near)) ++best;
      placed[unit] = best;
      paid_ += cost[best];
      const double* need = p_.demand.data() + static_cast<std::size_t>(unit) * p_.r;
      for (int k = 0; k < p_.r; ++k) {
        left_[k * M + best] -= need[k];
        share_[k * M + best] -= need[k] * p_.scale[k * M + best];
      }
    }
    return true;
  }

 private:
  void weigh_connectors(int unit, const Placement& placed, double* cost) const {
    for (int h = 0; h < M; ++h) cost[h] = p_.linear(unit, h);
    for (const Neighbour& other : p_.neighbours(unit)) {
      const int there = placed[other.unit];
      if (there < 0) continue;
      for (int h = 0; h < M; ++h) cost[h] += other.overhead * p_.far(there, h);
    }
  }

  double balance(int unit, int computer) const {
    double total = 0;
    for (int k = 0; k < p_.r; ++k) {
      if (p_.weight[k] <= 0) continue;
      const double* scale = p_.scale.data() + k * M;
      double share[M], low = kInfinity, high = -kInfinity, sum = 0;
      for (int h = 0; h < M; ++h) share[h] = share_[k * M + h];
      share[computer] -= p_.demand[static_cast<std::size_t>(unit) * p_.r + k] * scale[computer];
      for (int h = 0; h < M; ++h) {
        if (scale[h] <= 0) continue;
        low = std::min(low, share[h]);
        high = std::max(high, share[h]);
        sum += share[h];
      }
      if (!p_.variance) {
        total += p_.weight[k] * (high - low);
        continue;
      }
      const double mean = sum / p_.counted[k];
      double squares = 0;
      for (int h = 0; h < M; ++h) {
        if (scale[h] > 0) squares += (share[h] - mean) * (share[h] - mean);
      }
      total += p_.weight[k] * (squares / p_.counted[k]);
    }
    return total;
  }

  void shut(int unit, double* total) const {
    for (int h = 0; h < M; ++h) {
      bool fits = p_.allowed(unit, h);
      for (int k = 0; k < p_.r; ++k) {
        const double need = p_.demand[static_cast<std::size_t>(unit) * p_.r + k];
        fits &= left_[k * M + h] - need >= p_.floor[k * M + h];
      }
      if (!fits) total[h] = kInfinity;
    }
  }

  const Problem& p_;
  std::vector<double>&left_, &share_;
  double paid_ = 0;
};

}  // namespace

bool Greedy::is_few() const {
  return p_.m >= 2 && p_.m <= 4 && p_.bandwidth.empty() && !p_.has_apart();
}

bool Greedy::run_few(Placement& placed) {
  switch (p_.m) {
    case 2: return FewGreedy<2>(p_, first_share_, left_, share_).run(placed);
    case 3: return FewGreedy<3>(p_, first_share_, left_, share_).run(placed);
    default: return FewGreedy<4>(p_, first_share_, left_, share_).run(placed);
  }
}

}  // namespace poise
