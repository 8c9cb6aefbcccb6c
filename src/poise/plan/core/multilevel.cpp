#include "multilevel.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>

#include "greedy.h"
#include "times.h"

namespace poise {
namespace {

// Units left on the coarsest level, for each computer; few enough for the greedy to be
// quick, enough for it to balance.
constexpr int kUnitsPerComputer = 12;
// What a joined unit may ask for, of a mean limit.
constexpr double kLargest = 0.25;
constexpr int kMostPasses = 4;
// V-cycles: at most so many. After one that gains less than this share of F, the next cares
// more for the balance; with `kMostCare` that counts about as much as it does in F.
constexpr int kMostCycles = 40;
constexpr double kLeastGain = 1e-3;
constexpr double kLeastCare = 1.0 / 32, kMostCare = 0.5, kMoreCare = 1.5;

bool must_be_apart(const Problem& p, int i, int j) {
  const auto apart = p.apart(i);
  return std::find(apart.begin(), apart.end(), j) != apart.end();
}

// Heavy-edge matching: each unit, in random order, takes its heaviest free neighbour. With
// a placement, which may be empty, only of those on the same computer.
std::vector<std::int32_t> match(const Problem& p, const Placement& placed, double largest,
                                Random& random, int& count) {
  std::vector<double> limit(p.r);
  for (int k = 0; k < p.r; ++k) limit[k] = p.mean_room(k) * largest;
  std::vector<std::int32_t> part(p.n, -1), order(p.n);
  std::iota(order.begin(), order.end(), 0);
  for (int i = p.n; i > 1; --i) std::swap(order[i - 1], order[random.below(i)]);
  count = 0;
  for (const std::int32_t i : order) {
    if (part[i] >= 0) continue;
    int best = -1;
    double heaviest = 0;
    for (const Neighbour& other : p.neighbours(i)) {
      if (part[other.unit] >= 0 || other.overhead <= heaviest) continue;
      if (!placed.empty() && placed[i] != placed[other.unit]) continue;
      bool fits = p.may_join(i, other.unit) && !must_be_apart(p, i, other.unit);
      for (int k = 0; k < p.r; ++k) {
        fits &= p.need(i)[k] + p.need(other.unit)[k] <= limit[k];
      }
      if (!fits) continue;
      best = other.unit;
      heaviest = other.overhead;
    }
    part[i] = count;
    if (best >= 0) part[best] = count;
    ++count;
  }
  return part;
}

// A smaller problem in the shape of a larger one: connected units become one.
struct Coarse {
  Problem problem;
  std::vector<std::int32_t> part_of;  // unit of the larger problem -> unit of this one
};

// Join pairs of units along their heaviest connectors, where limits allow it. No joined
// unit asks for more than `largest` of any mean limit.
Coarse coarsen(const Problem& fine, const Placement& placed, double largest,
               Random& random) {
  int count = 0;
  std::vector<std::int32_t> part = match(fine, placed, largest, random, count);
  Problem coarse = fine.joined(part, count);
  return {std::move(coarse), std::move(part)};
}

// One level under refinement: residues, and the balance by its variance. Over many
// computers the range is a poor guide, as only two of them have a say in it.
class Level {
 public:
  Level(const Problem& problem, Placement& placed, double care)
      : p_(problem), placed_(placed), care_(care), left_(residues(problem, placed)),
        gain_(p_.m, 0.0), price_(p_.r, 0.0) {
    if (p_.time_limits) times_.emplace(p_).reset(placed);
  }

  // One pass over all units; how many moved.
  std::int64_t pass(Stop& stop) {
    reprice();
    std::int64_t moved = 0;
    for (int i = 0; i < p_.n; ++i) {
      moved += improve(i);
      if ((i & 1023) == 1023 && stop.after(1024)) break;
    }
    return moved;
  }

 private:
  // What a unit of squared residue costs, so that the balance counts for as much as it
  // does in F, and which computer has most left of anything.
  void reprice() {
    for (int k = 0; k < p_.r; ++k) {
      if (p_.weight[k] <= 0) continue;
      double low = kInfinity, high = -kInfinity, sum = 0, squares = 0;
      for (int h = 0; h < p_.m; ++h) {
        const double scale = p_.scale[k * p_.m + h];
        if (scale <= 0) continue;
        const double share = left_[k * p_.m + h] * scale;
        low = std::min(low, share);
        if (share > high) emptiest_ = h;
        high = std::max(high, share);
        sum += share;
        squares += share * share;
      }
      const double mean = sum / p_.counted[k];
      const double variance = std::max(squares / p_.counted[k] - mean * mean, 1e-12);
      price_[k] = p_.weight[k] / p_.counted[k] *
                  (p_.variance ? 1.0 : care_ * (high - low) / variance);
    }
  }

  bool improve(int unit) {
    const int here = placed_[unit];
    near_.clear();
    for (const Neighbour& other : p_.neighbours(unit)) {
      const int there = placed_[other.unit];
      if (gain_[there] == 0) near_.push_back(there);
      gain_[there] += other.overhead + 1e-300;
    }
    const double stays = gain_[here];
    int best = here;
    double least = -1e-12;
    const auto consider = [&](int h) {
      if (h == here || !fits(unit, h)) return;
      double change = paid(unit, here, h, stays) + balance(unit, here, h);
      if (times_ && change < least + times_->sum().paid) {
        const TimeSum times = times_->weigh(alone(unit, here, h));
        change = times.broken > 0 ? kInfinity : change + times.paid;
      }
      if (change < least) {
        least = change;
        best = h;
      }
    };
    for (const int h : near_) consider(h);
    if (gain_[emptiest_] == 0) consider(emptiest_);
    for (const int h : near_) gain_[h] = 0;
    if (best == here) return false;
    move(unit, here, best);
    return true;
  }

  double paid(int unit, int from, int to, double stays) const {
    double change = p_.linear(unit, to) - p_.linear(unit, from);
    if (p_.distance.empty()) return change + stays - gain_[to];
    for (const int h : near_) change += gain_[h] * (p_.far(to, h) - p_.far(from, h));
    return change;
  }

  double balance(int unit, int from, int to) const {
    double change = 0;
    for (int k = 0; k < p_.r; ++k) {
      if (price_[k] <= 0) continue;
      const double need = p_.demand[static_cast<std::size_t>(unit) * p_.r + k];
      const double sa = p_.scale[k * p_.m + from], sb = p_.scale[k * p_.m + to];
      const double a = left_[k * p_.m + from] * sa, b = left_[k * p_.m + to] * sb;
      const double da = need * sa, db = need * sb;
      change += price_[k] * (da * (da + 2 * a) + db * (db - 2 * b));
    }
    for (const int k : p_.priced) {
      const double need = p_.demand[static_cast<std::size_t>(unit) * p_.r + k];
      const double a = left_[k * p_.m + from], b = left_[k * p_.m + to];
      change += p_.price[k] * (p_.shortage(k, from, a + need) - p_.shortage(k, from, a) +
                               p_.shortage(k, to, b - need) - p_.shortage(k, to, b));
    }
    return change;
  }

  bool fits(int unit, int h) const {
    for (int k = 0; k < p_.r; ++k) {
      const double need = p_.demand[static_cast<std::size_t>(unit) * p_.r + k];
      if (left_[k * p_.m + h] - need < p_.floor[k * p_.m + h]) return false;
    }
    if (!p_.allowed(unit, h)) return false;
    for (const std::int32_t other : p_.apart(unit)) {
      if (placed_[other] == h) return false;
    }
    return true;
  }

  void move(int unit, int from, int to) {
    for (int k = 0; k < p_.r; ++k) {
      const double need = p_.demand[static_cast<std::size_t>(unit) * p_.r + k];
      left_[k * p_.m + from] += need;
      left_[k * p_.m + to] -= need;
    }
    if (times_) times_->apply(alone(unit, from, to));
    placed_[unit] = to;
  }

  static Shift alone(const int& unit, int from, int to) {
    return {{&unit, &unit + 1}, {nullptr, nullptr}, from, to};
  }

  const Problem& p_;
  Placement& placed_;
  const double care_;
  std::vector<double> left_;
  std::vector<double> gain_;  // (m): overhead towards each computer, of the unit at hand
  std::vector<double> price_;
  std::optional<Times> times_;
  std::vector<int> near_;
  int emptiest_ = 0;
};

// Move units to their neighbours' computers, or to emptier ones, while F falls. `placed`
// must be feasible, and stays so.
void refine(const Problem& p, Placement& placed, double care, Stop& stop) {
  if (p.m < 2) return;
  Level level(p, placed, care);
  Placement best = placed;
  double least = terms(p, placed).total();
  for (int i = 0; i < kMostPasses && !stop.stopped(); ++i) {
    const std::int64_t moved = level.pass(stop);
    const double total = terms(p, placed).total();
    // Moves are weighed without the links: what overfills one is not kept.
    const bool sums = !p.bandwidth.empty() || p.time_limits;
    if (total < least && (!sums || feasible(p, placed))) {
      least = total;
      best = placed;
    }
    if (moved * 100 < p.n) break;
  }
  placed = best;
}

using Levels = std::vector<std::unique_ptr<Coarse>>;

// Join units until few are left; `placed`, unless it is empty, becomes that of the last.
Levels joined(const Problem& problem, Placement& placed, Stop& stop, Random& random) {
  Levels levels;
  const Problem* now = &problem;
  const std::int64_t enough = static_cast<std::int64_t>(kUnitsPerComputer) * problem.m;
  while (now->n > enough && !stop.look()) {
    const int before = now->n;
    levels.push_back(std::make_unique<Coarse>(coarsen(*now, placed, kLargest, random)));
    now = &levels.back()->problem;
    if (!placed.empty()) {
      Placement coarse(now->n);
      for (int u = 0; u < before; ++u) coarse[levels.back()->part_of[u]] = placed[u];
      placed = std::move(coarse);
    }
    if (now->n > before * 0.95) break;
  }
  return levels;
}

// Refine a placement of the last level, and take it to the first.
void unfold(const Problem& problem, const Levels& levels, double care, Placement& placed,
            Stop& stop) {
  refine(levels.empty() ? problem : levels.back()->problem, placed, care, stop);
  for (std::size_t i = levels.size(); i-- > 0;) {
    const Problem& finer = i > 0 ? levels[i - 1]->problem : problem;
    const Placement coarse = std::move(placed);
    placed.resize(finer.n);
    for (int u = 0; u < finer.n; ++u) placed[u] = coarse[levels[i]->part_of[u]];
    refine(finer, placed, care, stop);
  }
}

}  // namespace

Placement multilevel(const Problem& problem, Stop& stop, Random& random) {
  Placement placed;
  Levels levels = joined(problem, placed, stop, random);
  // Where joined units are too large or held to too few computers, a finer level begins.
  while (!Greedy(levels.empty() ? problem : levels.back()->problem).run(placed)) {
    if (levels.empty()) return {};
    levels.pop_back();
  }
  unfold(problem, levels, kLeastCare, placed, stop);
  if (!feasible(problem, placed)) return {};
  // V-cycles: join units that are on the same computer, in another way each time. What is
  // connected comes together first; the balance counts more where that gains no more.
  double least = terms(problem, placed).total(), care = kLeastCare;
  for (int i = 0; i < kMostCycles && care <= kMostCare && !stop.look(); ++i) {
    Placement better = placed;
    levels = joined(problem, better, stop, random);
    unfold(problem, levels, care, better, stop);
    const double total = terms(problem, better).total();
    if (total >= least * (1 - kLeastGain)) care *= kMoreCare;
    if (total >= least || !feasible(problem, better)) continue;
    least = total;
    placed = std::move(better);
  }
  return placed;
}

}  // namespace poise
