#include "search/feasibility.h"

#include <algorithm>
#include <numeric>

namespace poise {
namespace {

// Elements in each of the two tables of subsets: together as many as are shared out. Five
// do as well, four find less.
constexpr int kHalf = 6;
constexpr std::size_t kSubsets = std::size_t{1} << kHalf;
// By how much what is exceeded becomes dearer; 0.05 and 1 take longer.
constexpr double kRaise = 0.5;
constexpr double kDearest = 1e6;
// After how many moves in vain, for each computer.
constexpr int kPatience = 4;
// A step is what a search move of the annealing takes, about 40 ns.
constexpr std::size_t kSubsetsPerStep = 32, kUnitsPerStep = 16;

// Add what a resource exceeds, priced, for each subset: a's load is `from` + shift, and b
// has the rest, which is too much when a has less than `least`.
void add_excess(double* excess, const double* shift, std::size_t count, double from,
                double most, double price_a, double least, double price_b) {
  for (std::size_t i = 0; i < count; ++i) {
    const double load = from + shift[i];
    const double above = load - most, below = least - load;
    excess[i] += price_a * (above > 0 ? above : 0) + price_b * (below > 0 ? below : 0);
  }
}

}  // namespace

Feasibility::Feasibility(const Problem& problem, Stop& stop, Random& random)
    : p_(problem), stop_(stop), random_(random), r_(problem.r),
      need_(static_cast<std::size_t>(p_.n) * r_), room_(static_cast<std::size_t>(p_.m) * r_),
      load_(room_.size(), 0.0), price_(room_.size(), 1.0), placed_(p_.n, -1), on_(p_.m),
      spot_(p_.n), over_(p_.m, 0.0), broken_spot_(p_.m, -1), seen_(p_.n, 0),
      low_(r_ * kSubsets), high_(r_ * kSubsets), excess_(kSubsets) {
  for (int k = 0; k < r_; ++k) {
    const double mean = p_.mean_room(k), unit = mean > 0 ? 1 / mean : 1.0;
    // A little less, as sums in another order may come out larger.
    for (int h = 0; h < p_.m; ++h) room_[h * r_ + k] = p_.room(k, h) * unit * (1 - 1e-12);
    for (int i = 0; i < p_.n; ++i) need_[i * r_ + k] = p_.demand[i * r_ + k] * unit;
  }
}

Placement Feasibility::run() {
  if (!fill()) return {};
  int idle = 0;
  while (!broken_.empty() && p_.m > 1 && !stop_.stopped()) {
    if (split()) idle = 0;
    else if (++idle >= kPatience * p_.m) {
      raise();
      idle = 0;
    }
  }
  return placed_;
}

// Place every unit: those with the fewest choices first, then the largest, each where it
// fits best.
bool Feasibility::fill() {
  std::vector<int> choices(p_.n);
  std::vector<double> size(p_.n, 0.0);
  for (int i = 0; i < p_.n; ++i) {
    choices[i] = p_.choices(i);
    for (int k = 0; k < r_; ++k) size[i] = std::max(size[i], need_[i * r_ + k]);
  }
  std::vector<std::int32_t> order(p_.n);
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
    if (choices[a] != choices[b]) return choices[a] < choices[b];
    return size[a] != size[b] ? size[a] > size[b] : a < b;
  });
  for (const std::int32_t unit : order) {
    const int h = most_fitting(unit);
    if (h < 0) return false;
    put(unit, h);
  }
  for (int h = 0; h < p_.m; ++h) weigh(h);
  return true;
}

int Feasibility::most_fitting(int unit) const {
  int best = -1;
  double most = -kInfinity;
  for (int h = 0; h < p_.m; ++h) {
    if (!p_.allowed(unit, h)) continue;
    const double value = worth(unit, h);
    if (best >= 0 && value <= most) continue;
    best = h;
    most = value;
  }
  return best;
}

// How well a unit goes with what is left on a computer: it asks most of what there is most
// of. Worse is what exceeds a limit, and worst to meet what it must be apart from.
double Feasibility::worth(int unit, int h) const {
  double excess = 0, match = 0;
  for (int k = 0; k < r_; ++k) {
    const double left = room_[h * r_ + k] - load_[h * r_ + k];
    const double need = need_[unit * r_ + k];
    if (need > left) excess += need - std::max(left, 0.0);
    match += need * left;
  }
  for (const std::int32_t other : p_.apart(unit)) {
    if (placed_[other] == h) excess += 1e6;
  }
  return excess > 0 ? -excess : match;
}

void Feasibility::put(int unit, int h) {
  for (int k = 0; k < r_; ++k) load_[h * r_ + k] += need_[unit * r_ + k];
  spot_[unit] = static_cast<std::int32_t>(on_[h].size());
  on_[h].push_back(unit);
  placed_[unit] = h;
}

void Feasibility::take(int unit) {
  auto& units = on_[placed_[unit]];
  units[spot_[unit]] = units.back();
  spot_[units.back()] = spot_[unit];
  units.pop_back();
}

// Recompute a computer's load, and what it exceeds.
void Feasibility::weigh(int h) {
  for (int k = 0; k < r_; ++k) {
    double load = 0;
    for (const std::int32_t unit : on_[h]) load += need_[unit * r_ + k];
    load_[h * r_ + k] = load;
  }
  over_[h] = 0;
  for (int k = 0; k < r_; ++k) {
    over_[h] += price_[h * r_ + k] * std::max(0.0, load_[h * r_ + k] - room_[h * r_ + k]);
  }
  if (over_[h] > 0 && broken_spot_[h] < 0) {
    broken_spot_[h] = static_cast<std::int32_t>(broken_.size());
    broken_.push_back(h);
  } else if (over_[h] <= 0 && broken_spot_[h] >= 0) {
    const std::int32_t last = broken_.back();
    broken_[broken_spot_[h]] = last;
    broken_spot_[last] = broken_spot_[h];
    broken_.pop_back();
    broken_spot_[h] = -1;
  }
}

void Feasibility::raise() {
  double dearest = 0;
  for (const std::int32_t h : broken_) {
    for (int k = 0; k < r_; ++k) {
      if (load_[h * r_ + k] > room_[h * r_ + k]) price_[h * r_ + k] *= 1 + kRaise;
      dearest = std::max(dearest, price_[h * r_ + k]);
    }
  }
  if (dearest > kDearest) std::fill(price_.begin(), price_.end(), 1.0);
  for (int h = 0; h < p_.m; ++h) weigh(h);
}

// Divide some units of two computers again; whether less is exceeded.
bool Feasibility::split() {
  int a = random_.below(p_.m);
  if (random_.below(4) > 0) a = broken_[random_.below(static_cast<int>(broken_.size()))];
  int b = random_.below(p_.m - 1);
  b += b >= a;
  gather(a, b);
  choose(a);
  sum_up(a);
  const double now = over_[a] + over_[b];
  flip(least_exceeding(a, b, now), a, b);
  return over_[a] + over_[b] < now - 1e-12;
}

// Find what may change sides between two computers.
void Feasibility::gather(int a, int b) {
  stop_.after(static_cast<std::int64_t>((on_[a].size() + on_[b].size()) / kUnitsPerStep));
  ++round_;
  elements_.clear();
  chained_.clear();
  for (const int h : {a, b}) {
    for (const std::int32_t unit : on_[h]) {
      if (seen_[unit] == round_) continue;
      const std::size_t first = chained_.size();
      const bool free = chain(unit, a, b);
      if (free) elements_.push_back({first, chained_.size()});
      else chained_.resize(first);
    }
  }
}

// Gather a unit and, side by side, all that must be apart from those gathered; false when
// one of them may not change sides.
bool Feasibility::chain(int unit, int a, int b) {
  const std::size_t first = chained_.size();
  seen_[unit] = round_;
  chained_.push_back(unit);
  bool free = true;
  for (std::size_t i = first; i < chained_.size(); ++i) {
    const int here = placed_[chained_[i]];
    free &= p_.allowed(chained_[i], a + b - here);
    for (const std::int32_t other : p_.apart(chained_[i])) {
      if (placed_[other] != a + b - here || seen_[other] == round_) continue;
      seen_[other] = round_;
      chained_.push_back(other);
    }
  }
  return free;
}

// Keep a dozen elements that change something, in any order.
void Feasibility::choose(int a) {
  std::size_t kept = 0;
  shift_.assign(static_cast<std::size_t>(2 * kHalf) * r_, 0.0);
  for (std::size_t i = 0; i < elements_.size() && kept < 2 * kHalf; ++i) {
    const int left = static_cast<int>(elements_.size() - i);
    std::swap(elements_[i], elements_[i + random_.below(left)]);
    double* shift = shift_.data() + kept * r_;
    std::fill(shift, shift + r_, 0.0);
    bool any = false;
    for (std::size_t e = elements_[i].first; e < elements_[i].last; ++e) {
      const std::int32_t unit = chained_[e];
      for (int k = 0; k < r_; ++k) {
        shift[k] += placed_[unit] == a ? -need_[unit * r_ + k] : need_[unit * r_ + k];
        any |= shift[k] != 0;
      }
    }
    if (any) elements_[kept++] = elements_[i];
  }
  elements_.resize(kept);
}

// The sums of shifts over all subsets of the first elements, and of the others.
void Feasibility::sum_up(int a) {
  const std::size_t count = elements_.size();
  for (int k = 0; k < r_; ++k) {
    double* low = low_.data() + k * kSubsets;
    double* high = high_.data() + k * kSubsets;
    low[0] = 0;
    high[0] = load_[a * r_ + k];
    for (std::size_t e = 0; e < count; ++e) {
      double* sums = e < kHalf ? low : high;
      const std::size_t half = std::size_t{1} << (e < kHalf ? e : e - kHalf);
      for (std::size_t i = 0; i < half; ++i) sums[half + i] = sums[i] + shift_[e * r_ + k];
    }
  }
}

// The subset of elements whose flip leaves the least excess, if less than `now`, else 0.
// Of several that fit, any.
std::size_t Feasibility::least_exceeding(int a, int b, double now) {
  const std::size_t count = elements_.size();
  const std::size_t lows = std::size_t{1} << std::min<std::size_t>(count, kHalf);
  const std::size_t highs = std::size_t{1} << (count > kHalf ? count - kHalf : 0);
  stop_.after(static_cast<std::int64_t>(lows * highs / kSubsetsPerStep + 1));
  const std::uint64_t dice = random_.next();
  std::size_t best = 0;
  double least = now > 0 ? now : kInfinity;
  for (std::size_t i = 0; i < highs && least > 0; ++i) {
    const std::size_t high = i ^ ((dice >> 32) & (highs - 1));
    std::fill(excess_.begin(), excess_.end(), 0.0);
    for (int k = 0; k < r_; ++k) {
      const std::size_t ea = static_cast<std::size_t>(a) * r_ + k;
      const std::size_t eb = static_cast<std::size_t>(b) * r_ + k;
      add_excess(excess_.data(), low_.data() + k * kSubsets, lows,
                 high_[k * kSubsets + high], room_[ea], price_[ea],
                 load_[ea] + load_[eb] - room_[eb], price_[eb]);
    }
    double lowest = excess_[0];
    for (std::size_t j = 1; j < lows; ++j) lowest = std::min(lowest, excess_[j]);
    if (lowest >= least) continue;
    least = lowest;
    std::size_t low = dice & (lows - 1);
    while (excess_[low] > lowest) low = (low + 1) & (lows - 1);
    best = (high << kHalf) | low;
  }
  return best;
}

void Feasibility::flip(std::size_t subset, int a, int b) {
  if (subset == 0) return;
  for (std::size_t i = 0; i < elements_.size(); ++i) {
    if (!((subset >> i) & 1)) continue;
    for (std::size_t e = elements_[i].first; e < elements_[i].last; ++e) {
      const std::int32_t unit = chained_[e];
      const int to = a + b - placed_[unit];
      take(unit);
      put(unit, to);
    }
  }
  weigh(a);
  weigh(b);
}

}  // namespace poise
