#include "greedy.h"

#include <algorithm>
#include <cmath>

// Twice as many computers at once where the processor can; the results are the same to
// the last bit, as nothing is fused or reordered.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__)
#define POISE_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define POISE_WIDE
#endif

namespace poise {
namespace {

// Add weight x (high - smallest residue with `need` there), for each of m computers.
POISE_WIDE void add_range(double* total, const double* share, const double* scale, int m,
                          double need, double weight, double low, double high) {
  for (int h = 0; h < m; ++h) {
    const double after = share[h] - need * scale[h];
    total[h] += weight * (high - (after < low ? after : low));
  }
}

// Set F to infinity where less is left than is needed.
POISE_WIDE void shut(double* total, const double* left, const double* floor, int m,
                     double need) {
  for (int h = 0; h < m; ++h) total[h] = left[h] - need < floor[h] ? kInfinity : total[h];
}

}  // namespace

Greedy::Greedy(const Problem& problem) : p_(problem) {
  if (FewGreedy::takes(p_)) {
    few_ = std::make_unique<FewGreedy>(p_);
    return;
  }
  first_share_.resize(p_.capacity.size());
  for (std::size_t e = 0; e < first_share_.size(); ++e) {
    // A computer without the resource must be neither the lowest nor the highest.
    const double none = p_.variance ? 0.0 : kInfinity;
    first_share_[e] = p_.scale[e] > 0 ? p_.capacity[e] * p_.scale[e] : none;
  }
  total_.resize(p_.m);
  balance_.resize(p_.r);
  share_ = first_share_;
  for (int k = 0; k < p_.r; ++k) {
    balance_[k] = {};
    balance_[k].low = kInfinity;
    for (int h = 0; h < p_.m && p_.counted[k] > 0; ++h) {
      if (p_.scale[k * p_.m + h] <= 0) continue;
      balance_[k].centre += share_[k * p_.m + h] / p_.counted[k];
      balance_[k].low = std::min(balance_[k].low, share_[k * p_.m + h]);
    }
    for (int h = 0; h < p_.m; ++h) {
      if (p_.scale[k * p_.m + h] <= 0) continue;
      const double off = share_[k * p_.m + h] - balance_[k].centre;
      balance_[k].sum += off;
      balance_[k].squares += off * off;
    }
    scan(k);
  }
  first_balance_ = balance_;
}

bool Greedy::run(Placement& placed) {
  if (few_) return few_->run(placed);
  start();
  placed.assign(p_.n, -1);
  for (const std::int32_t unit : p_.order) {
    weigh(unit, placed);
    const int computer = best();
    if (computer < 0) return false;
    placed[unit] = computer;
    pay(unit, computer, placed);
    use(unit, computer);
  }
  return true;
}

void Greedy::start() {
  left_ = p_.capacity;
  share_ = first_share_;
  balance_ = first_balance_;
  traffic_.assign(p_.bandwidth.size(), 0.0);
  paid_ = 0;
}

void Greedy::weigh(int unit, const Placement& placed) {
  weigh_connectors(unit, placed);
  const double* need = p_.demand.data() + static_cast<std::size_t>(unit) * p_.r;
  for (int k = 0; k < p_.r; ++k) {
    if (p_.weight[k] <= 0) continue;
    p_.variance ? weigh_variance(k, need[k]) : weigh_range(k, need[k]);
  }
  close(unit, placed);
}

void Greedy::weigh_connectors(int unit, const Placement& placed) {
  double all = paid_;
  for (const Neighbour& other : p_.neighbours(unit)) {
    if (placed[other.unit] >= 0 && p_.distance.empty()) all += other.overhead;
  }
  std::fill(total_.begin(), total_.end(), all);
  for (const Neighbour& other : p_.neighbours(unit)) {
    const int there = placed[other.unit];
    if (there < 0) continue;
    if (p_.distance.empty()) {
      total_[there] -= other.overhead;
    } else {
      const double* row = p_.distance.data() + static_cast<std::size_t>(there) * p_.m;
      for (int h = 0; h < p_.m; ++h) total_[h] += other.overhead * row[h];
    }
  }
  if (p_.cost.empty()) return;
  const double* row = p_.cost.data() + static_cast<std::size_t>(unit) * p_.m;
  for (int h = 0; h < p_.m; ++h) total_[h] += row[h];
}

void Greedy::weigh_range(int k, double need) {
  const Balance& b = balance_[k];
  const double* share = share_.data() + static_cast<std::size_t>(k) * p_.m;
  const double* scale = p_.scale.data() + static_cast<std::size_t>(k) * p_.m;
  const double weight = p_.weight[k], low = b.low, high = b.high;
  const double before = total_[b.highest];
  add_range(total_.data(), share, scale, p_.m, need, weight, low, high);
  // Where the residue is largest, it may no longer be once the unit is there.
  const double after = share[b.highest] - need * scale[b.highest];
  total_[b.highest] =
      before + weight * (std::max(b.second, after) - std::min(low, after));
}

void Greedy::weigh_variance(int k, double need) {
  const Balance& b = balance_[k];
  const double* share = share_.data() + static_cast<std::size_t>(k) * p_.m;
  const double* scale = p_.scale.data() + static_cast<std::size_t>(k) * p_.m;
  const double weight = p_.weight[k], part = 1.0 / p_.counted[k], centre = b.centre;
  for (int h = 0; h < p_.m; ++h) {
    const double less = need * scale[h], now = share[h] - centre;
    const double mean = (b.sum - less) * part;
    const double squares = b.squares + less * (less - 2 * now);
    total_[h] += weight * (squares * part - mean * mean);
  }
}

// Set F to infinity wherever a limit keeps the unit out.
void Greedy::close(int unit, const Placement& placed) {
  const double* need = p_.demand.data() + static_cast<std::size_t>(unit) * p_.r;
  for (int k = 0; k < p_.r; ++k) {
    const double* left = left_.data() + static_cast<std::size_t>(k) * p_.m;
    const double* floor = p_.floor.data() + static_cast<std::size_t>(k) * p_.m;
    shut(total_.data(), left, floor, p_.m, need[k]);
  }
  if (p_.restricted(unit)) {
    for (int h = 0; h < p_.m; ++h) {
      if (!p_.allowed(unit, h)) total_[h] = kInfinity;
    }
  }
  for (const std::int32_t other : p_.apart(unit)) {
    if (other == unit) std::fill(total_.begin(), total_.end(), kInfinity);
    else if (placed[other] >= 0) total_[placed[other]] = kInfinity;
  }
  if (p_.bandwidth.empty()) return;
  std::vector<double> sent(p_.m, 0.0);
  for (const Neighbour& other : p_.neighbours(unit)) {
    if (placed[other.unit] >= 0) sent[placed[other.unit]] += other.traffic;
  }
  for (int h = 0; h < p_.m; ++h) {
    for (int c = 0; c < p_.m; ++c) {
      if (c == h || sent[c] <= 0) continue;
      const double limit = p_.bandwidth[h * p_.m + c];
      const double used = traffic_[h * p_.m + c] + sent[c];
      if (used > limit + kSlack * std::max(1.0, limit)) total_[h] = kInfinity;
    }
  }
}

// The first computer whose F is lowest, within rounding.
int Greedy::best() const {
  // Four at a time, as each comparison waits for the one before it.
  double low[4] = {kInfinity, kInfinity, kInfinity, kInfinity};
  int h4 = 0;
  for (; h4 + 4 <= p_.m; h4 += 4) {
    for (int i = 0; i < 4; ++i) low[i] = std::min(low[i], total_[h4 + i]);
  }
  for (; h4 < p_.m; ++h4) low[0] = std::min(low[0], total_[h4]);
  const double lowest = std::min(std::min(low[0], low[1]), std::min(low[2], low[3]));
  if (lowest == kInfinity) return -1;
  const double near = lowest + 1e-12 * std::max(1.0, std::fabs(lowest));
  int h = 0;
  while (!(total_[h] <= near)) ++h;
  return h;
}

void Greedy::pay(int unit, int computer, const Placement& placed) {
  paid_ += p_.linear(unit, computer);
  for (const Neighbour& other : p_.neighbours(unit)) {
    const int there = placed[other.unit];
    if (there < 0) continue;
    paid_ += other.overhead * p_.far(computer, there);
    if (p_.bandwidth.empty()) continue;
    traffic_[computer * p_.m + there] += other.traffic;
    traffic_[there * p_.m + computer] += other.traffic;
  }
}

void Greedy::use(int unit, int computer) {
  const double* need = p_.demand.data() + static_cast<std::size_t>(unit) * p_.r;
  for (int k = 0; k < p_.r; ++k) {
    Balance& b = balance_[k];
    const std::size_t e = static_cast<std::size_t>(k) * p_.m + computer;
    left_[e] -= need[k];
    if (p_.weight[k] <= 0) continue;
    const double less = need[k] * p_.scale[e], now = share_[e] - b.centre;
    share_[e] -= less;
    if (p_.variance) {
      b.sum -= less;
      b.squares += less * (less - 2 * now);
    } else {
      b.low = std::min(b.low, share_[e]);
      if (computer == b.highest || share_[e] + less >= b.second) scan(k);
    }
  }
}

// Find the largest and second largest residue of a resource anew.
void Greedy::scan(int k) {
  Balance& b = balance_[k];
  b.high = b.second = -kInfinity;
  b.highest = 0;
  const double* share = share_.data() + static_cast<std::size_t>(k) * p_.m;
  for (int h = 0; h < p_.m; ++h) {
    if (p_.scale[k * p_.m + h] <= 0 || share[h] <= b.second) continue;
    if (share[h] > b.high) {
      b.second = b.high;
      b.high = share[h];
      b.highest = h;
    } else {
      b.second = share[h];
    }
  }
}

}  // namespace poise
