#include "greedy.h"

#include <algorithm>
#include <cmath>

#include "wide.h"

namespace poise {
namespace {

constexpr int kBlock = 16;        // computers
constexpr int kManyComputers = 256; // from here on it pays to leave blocks out

// Add what the range comes to with `need` on each of m computers; infinite where there
// is no room for it.
POISE_WIDE void add_range(double* __restrict total, const double* share,
                          const double* room, const double* scale, int m, double need,
                          const Greedy::Balance& b) {
  const double weight = b.weight, low = b.low, high = b.high, second = b.second;
  for (int h = 0; h < m; ++h) {
    const double after = share[h] - need * scale[h];
    // Where the share is the largest, it may no longer be once the unit is there.
    const double rest = after > second ? after : second;
    const double top = share[h] == high ? rest : high;
    const double with = total[h] + weight * (top - (after < low ? after : low));
    total[h] = room[h] < need ? kInfinity : with;
  }
}

POISE_WIDE void add_variance(double* __restrict total, const double* share,
                             const double* room, const double* scale, int m, double need,
                             const Greedy::Balance& b) {
  const double weight = b.weight, part = b.part, centre = b.centre;
  const double sum = b.sum, all_squares = b.squares;
  for (int h = 0; h < m; ++h) {
    const double less = need * scale[h], now = share[h] - centre;
    const double mean = (sum - less) * part;
    const double squares = all_squares + less * (less - 2 * now);
    const double with = total[h] + weight * (squares * part - mean * mean);
    total[h] = room[h] < need ? kInfinity : with;
  }
}

POISE_WIDE void set_sum(double* __restrict total, double all, const double* extra, int m) {
  for (int h = 0; h < m; ++h) total[h] = all + extra[h];
}

POISE_WIDE void keep_limit(double* __restrict total, const double* room, int m,
                           double need) {
  for (int h = 0; h < m; ++h) total[h] = room[h] < need ? kInfinity : total[h];
}

// The lowest of some numbers. Four at a time, as each comparison waits for the one
// before it.
POISE_WIDE double lowest_of(const double* values, int count) {
  double low[4] = {kInfinity, kInfinity, kInfinity, kInfinity};
  int i = 0;
  for (; i + 4 <= count; i += 4) {
    for (int j = 0; j < 4; ++j) low[j] = values[i + j] < low[j] ? values[i + j] : low[j];
  }
  for (; i < count; ++i) low[0] = values[i] < low[0] ? values[i] : low[0];
  return std::min(std::min(low[0], low[1]), std::min(low[2], low[3]));
}

// Raise `high` and `second` to the two largest of them and some numbers, two at a time.
// An infinite one stands for a computer without the resource, and does not count.
POISE_WIDE void raise(double& high, double& second, const double* values, int count) {
  double most = high, more = second, other = -kInfinity, less = -kInfinity;
  for (int i = 0; i + 2 <= count; i += 2) {
    const double a = values[i] < kInfinity ? values[i] : -kInfinity;
    const double b = values[i + 1] < kInfinity ? values[i + 1] : -kInfinity;
    more = std::max(more, std::min(most, a));
    less = std::max(less, std::min(other, b));
    most = std::max(most, a);
    other = std::max(other, b);
  }
  if (count % 2 > 0 && values[count - 1] < kInfinity) {
    more = std::max(more, std::min(most, values[count - 1]));
    most = std::max(most, values[count - 1]);
  }
  high = std::max(most, other);
  second = std::max(std::min(most, other), std::max(more, less));
}

// All that is within rounding of F; numbers that overflowed are within nothing's.
double near(double total) {
  const double rounding = 1e-12 * std::max(1.0, std::fabs(total));
  return rounding < kInfinity ? total + rounding : total;
}

int first_below(const double* total, double limit) {
  int h = 0;
  while (!(total[h] <= limit)) ++h;
  return h;
}

}  // namespace

Greedy::Greedy(const Problem& problem) : p_(problem) {
  bool alike = p_.m >= kManyComputers && p_.cost.empty() && p_.distance.empty() &&
               p_.bandwidth.empty();
  first_share_.resize(p_.capacity.size());
  first_balance_.assign(p_.r, {});
  for (int k = 0; k < p_.r; ++k) {
    Balance& b = first_balance_[k];
    b.low = kInfinity;
    b.weight = p_.weight[k];
    b.part = p_.counted[k] > 0 ? 1.0 / p_.counted[k] : 0.0;
    for (int h = 0; h < p_.m; ++h) {
      const std::size_t e = static_cast<std::size_t>(k) * p_.m + h;
      const double scale = p_.scale[e];
      alike &= b.weight <= 0 ||
               (scale > 0 && scale == p_.scale[static_cast<std::size_t>(k) * p_.m]);
      // A computer without the resource must be neither the lowest nor the highest.
      first_share_[e] = scale > 0 ? p_.capacity[e] * scale
                                  : p_.variance ? 0.0 : kInfinity;
      if (scale <= 0) continue;
      b.centre += first_share_[e] / p_.counted[k];
      b.low = std::min(b.low, first_share_[e]);
    }
    for (int h = 0; h < p_.m; ++h) {
      const std::size_t e = static_cast<std::size_t>(k) * p_.m + h;
      if (p_.scale[e] <= 0) continue;
      const double off = first_share_[e] - b.centre;
      b.sum += off;
      b.squares += off * off;
    }
  }
  total_.resize(p_.m);
  extra_.assign(p_.m, 0.0);
  if (!alike) return;
  blocks_ = (p_.m + kBlock - 1) / kBlock;
  top_.resize(static_cast<std::size_t>(p_.r) * blocks_);
  second_.resize(top_.size());
  top_room_.resize(top_.size());
  bound_.resize(blocks_);
  least_.resize(blocks_);
}

bool Greedy::run(Placement& placed) {
  start();
  placed.assign(p_.n, -1);
  for (int i = 0; i < p_.n; ++i) {
    const std::int32_t unit = p_.order[i];
    // Units come by size, so each is somewhere else in memory.
    if (i + 8 < p_.n) p_.prefetch(p_.order[i + 8]);
    const int computer = decide(unit, placed);
    if (computer < 0) return false;
    placed[unit] = computer;
    pay(unit, computer);
    use(p_.demand.data() + static_cast<std::size_t>(unit) * p_.r, computer);
  }
  return true;
}

void Greedy::start() {
  room_.resize(p_.capacity.size());
  for (std::size_t e = 0; e < room_.size(); ++e) room_[e] = p_.capacity[e] - p_.floor[e];
  share_ = first_share_;
  balance_ = first_balance_;
  traffic_.assign(p_.bandwidth.size(), 0.0);
  paid_ = 0;
  for (int k = 0; k < p_.r; ++k) {
    for (int block = 0; block < blocks_; ++block) find_block(k, block);
    find_high(k);
  }
}

int Greedy::decide(int unit, const Placement& placed) {
  gather(unit, placed);
  const bool blocks =
      blocks_ > 0 && !p_.restricted(unit) && p_.apart(unit).size() == 0;
  const double* need = p_.demand.data() + static_cast<std::size_t>(unit) * p_.r;
  return blocks ? best_of_blocks(need) : best_of_all(unit);
}

// What the unit pays on each computer: `all_` and `extra_`.
void Greedy::gather(int unit, const Placement& placed) {
  for (const std::int32_t h : touched_) extra_[h] = 0;
  touched_.clear();
  ties_.clear();
  all_ = paid_;
  if (!p_.cost.empty()) {
    const double* row = p_.cost.data() + static_cast<std::size_t>(unit) * p_.m;
    std::copy(row, row + p_.m, extra_.begin());
  } else if (!p_.distance.empty()) {
    std::fill(extra_.begin(), extra_.end(), 0.0);
  }
  for (const Neighbour& other : p_.neighbours(unit)) {
    const int there = placed[other.unit];
    if (there < 0) continue;
    ties_.push_back({there, other.overhead, other.traffic});
    if (p_.distance.empty()) {
      all_ += other.overhead;
      extra_[there] -= other.overhead;
      touched_.push_back(there);
    } else {
      const double* row = p_.distance.data() + static_cast<std::size_t>(there) * p_.m;
      for (int h = 0; h < p_.m; ++h) extra_[h] += other.overhead * row[h];
    }
  }
  for (const std::int32_t other : p_.apart(unit)) {
    const int there = placed[other];
    if (there < 0) continue;
    extra_[there] = kInfinity;
    touched_.push_back(there);
  }
}

// F with the unit on each of some computers. Tables by resource are `stride` apart.
void Greedy::weigh(const double* need, int count, double* total, const double* share,
                   const double* room, const double* scale, int stride) const {
  for (int k = 0; k < p_.r; ++k) {
    const Balance& b = balance_[k];
    if (b.weight <= 0) keep_limit(total, room, count, need[k]);
    else if (p_.variance) add_variance(total, share, room, scale, count, need[k], b);
    else add_range(total, share, room, scale, count, need[k], b);
    share += stride;
    room += stride;
    scale += p_.m;
  }
}

// The first computer whose F is lowest, within rounding; -1 when none is finite.
int Greedy::best_of_all(int unit) {
  const double* need = p_.demand.data() + static_cast<std::size_t>(unit) * p_.r;
  set_sum(total_.data(), all_, extra_.data(), p_.m);
  weigh(need, p_.m, total_.data(), share_.data(), room_.data(), p_.scale.data(), p_.m);
  shut(unit);
  const double lowest = lowest_of(total_.data(), p_.m);
  return lowest == kInfinity ? -1 : first_below(total_.data(), near(lowest));
}

int Greedy::best_of_blocks(const double* need) {
  std::fill(bound_.begin(), bound_.end(), all_);
  weigh(need, blocks_, bound_.data(), top_.data(), top_room_.data(), p_.scale.data(),
        blocks_);
  std::fill(least_.begin(), least_.end(), kInfinity);
  double lowest = kInfinity;
  int where = blocks_;  // the first block with the lowest
  const auto look = [&](int block) {
    weigh_block(need, block);
    if (least_[block] < lowest || (least_[block] == lowest && block < where)) {
      lowest = least_[block];
      where = block;
    }
    bound_[block] = kInfinity;
  };
  for (const std::int32_t h : touched_) {
    if (bound_[h / kBlock] < kInfinity) look(h / kBlock);
  }
  // A block behind the best one must be better to matter, one before it as good.
  for (int block = 0; block < blocks_; ++block) {
    const double bound = bound_[block];
    if (bound == kInfinity) continue;
    if (block < where ? bound <= near(lowest) : bound < lowest) look(block);
  }
  if (lowest == kInfinity) return -1;
  const double limit = near(lowest);
  const int block = first_below(least_.data(), limit);
  return block * kBlock + first_below(total_.data() + block * kBlock, limit);
}

void Greedy::weigh_block(const double* need, int block) {
  const int first = block * kBlock, count = std::min(kBlock, p_.m - first);
  double* total = total_.data() + first;
  set_sum(total, all_, extra_.data() + first, count);
  weigh(need, count, total, share_.data() + first, room_.data() + first,
        p_.scale.data() + first, p_.m);
  least_[block] = lowest_of(total, count);
}

// Set F to infinity where something else than room keeps the unit out.
void Greedy::shut(int unit) {
  if (p_.restricted(unit)) {
    for (int h = 0; h < p_.m; ++h) {
      if (!p_.allowed(unit, h)) total_[h] = kInfinity;
    }
  }
  for (const std::int32_t other : p_.apart(unit)) {
    if (other == unit) std::fill(total_.begin(), total_.end(), kInfinity);
  }
  if (!p_.bandwidth.empty()) shut_full_links();
}

void Greedy::shut_full_links() {
  std::vector<double> sent(p_.m, 0.0);
  for (const Tie& tie : ties_) sent[tie.computer] += tie.traffic;
  for (int h = 0; h < p_.m; ++h) {
    for (int c = 0; c < p_.m; ++c) {
      if (c == h || sent[c] <= 0) continue;
      const double limit = p_.bandwidth[h * p_.m + c];
      const double used = traffic_[h * p_.m + c] + sent[c];
      if (used > limit + kSlack * std::max(1.0, limit)) total_[h] = kInfinity;
    }
  }
}

void Greedy::pay(int unit, int computer) {
  paid_ += p_.linear(unit, computer);
  for (const Tie& tie : ties_) {
    paid_ += tie.overhead * p_.far(computer, tie.computer);
    if (p_.bandwidth.empty()) continue;
    traffic_[computer * p_.m + tie.computer] += tie.traffic;
    traffic_[tie.computer * p_.m + computer] += tie.traffic;
  }
}

void Greedy::use(const double* need, int computer) {
  for (int k = 0; k < p_.r; ++k) {
    Balance& b = balance_[k];
    const std::size_t e = static_cast<std::size_t>(k) * p_.m + computer;
    const double less = need[k] * p_.scale[e], before = share_[e], now = before - b.centre;
    const double room = room_[e];
    room_[e] -= need[k];
    share_[e] -= less;
    if (blocks_ > 0) {
      const int block = computer / kBlock;
      const std::size_t at = static_cast<std::size_t>(k) * blocks_ + block;
      if (before >= second_[at] || room >= top_room_[at]) find_block(k, block);
    }
    if (b.weight <= 0) continue;
    if (p_.variance) {
      b.sum -= less;
      b.squares += less * (less - 2 * now);
    } else {
      b.low = std::min(b.low, share_[e]);
      if (before >= b.second) find_high(k);
    }
  }
}

// Find the largest shares and room in a block anew.
void Greedy::find_block(int k, int block) {
  const int first = block * kBlock, count = std::min(kBlock, p_.m - first);
  const std::size_t e = static_cast<std::size_t>(k) * p_.m + first;
  const std::size_t b = static_cast<std::size_t>(k) * blocks_ + block;
  top_[b] = second_[b] = -kInfinity;
  raise(top_[b], second_[b], &share_[e], count);
  top_room_[b] = *std::max_element(&room_[e], &room_[e] + count);
}

// Find the largest and second largest share of a resource anew.
void Greedy::find_high(int k) {
  Balance& b = balance_[k];
  b.high = b.second = -kInfinity;
  if (blocks_ == 0) {
    raise(b.high, b.second, &share_[static_cast<std::size_t>(k) * p_.m], p_.m);
    return;
  }
  const std::size_t first = static_cast<std::size_t>(k) * blocks_;
  raise(b.high, b.second, &top_[first], blocks_);
  raise(b.high, b.second, &second_[first], blocks_);
}

}  // namespace poise
