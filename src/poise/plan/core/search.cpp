#include "search.h"

#include <algorithm>

#include "greedy.h"
#include "multilevel.h"
#include "relaxation.h"

namespace poise {
namespace {

// Which part of the time goes into cooling, when there is local search to be done after it.
constexpr int kCoolingShare = 5;
// No first cooling is longer, though there be time for it: who stops the search early is
// to have something good by then. Each later one may be twice as long.
constexpr std::int64_t kLongestFirst = 1 << 20;
// From here on, joining units first is worth it.
constexpr int kManyUnits = 400;
// How hot each cooling begins, in mean changes of F: the first keeps much of where it
// starts, the others come back when local search leads no further. Found by trial.
constexpr double kHeats[4] = {0.2, 0.5, 1.0, 2.0};

// Where to start when the greedy comes to a dead end: the units that it has not placed go
// to any computer that they may run on. Empty when one may run nowhere.
Placement anywhere(const Problem& p, Random& random) {
  Placement placed;
  Greedy(p).run(placed);
  for (int i = 0; i < p.n; ++i) {
    if (placed[i] >= 0) continue;
    const int choices = p.choices(i);
    if (choices == 0) return {};
    int skip = random.below(choices), h = 0;
    while (!p.allowed(i, h) || skip-- > 0) ++h;
    placed[i] = h;
  }
  return placed;
}

}  // namespace

Search::Search(const Problem& problem, Stop& stop, std::uint64_t seed)
    : p_(problem), stop_(stop), random_(seed), state_(problem), repartition_(problem),
      seen_(p_.n, 0) {
  for (int i = 0; i < p_.n; ++i) {
    if (p_.choices(i) > 1) movable_.push_back(i);
  }
}

void Search::offer(const Placement& placed) {
  if (placed.empty()) return;
  if (!feasible(p_, placed)) return;
  const double total = terms(p_, placed).total();
  if (total >= best_objective_) return;
  best_ = placed;
  best_objective_ = total;
}

void Search::run(const Placement& start) {
  offer(start);
  if (done()) return;
  state_.reset(start);
  std::int64_t length = 64 * static_cast<std::int64_t>(p_.n);
  // A first short cooling also shows the pace, by which a later one fills its share.
  // While nothing keeps all limits, many short ones find more than a long one.
  cool(length, kHeats[0]);
  for (int round = 0; !found() && !stop_.look(); ++round) {
    aimless_ = round % 4 < 3;
    cool(length, kHeats[round % 4]);
    length += length / 4;
  }
  aimless_ = false;
  const std::int64_t shortest = 64 * static_cast<std::int64_t>(p_.n);
  const bool is_fleet = p_.n >= kManyUnits;
  length = is_fleet ? shortest : std::max(shortest, stop_.steps_left() / kCoolingShare);
  for (int round = 0; !stop_.look(); ++round) {
    if (round > 0) state_.reset(best_);
    cool(std::min(length, kLongestFirst << std::min(round, 20)), kHeats[round % 4]);
    local_search();
  }
}

Outcome search(const Problem& p, const Placement& known, Stop& stop, std::uint64_t seed) {
  Outcome out;
  Random random(seed ^ 0x9e3779b97f4a7c15U);
  Placement start = known;
  if (p.n >= kManyUnits && !stop.stopped()) {
    Placement joined = multilevel(p, stop, random);
    const bool better = !joined.empty() &&
                        (start.empty() || terms(p, joined).total() < terms(p, start).total());
    if (better) start = std::move(joined);
  }
  if (start.empty()) start = anywhere(p, random);
  Search search(p, stop, seed);
  if (static_cast<int>(start.size()) == p.n) search.run(start);
  out.placed = search.best();
  out.bound = relaxation_bound(p);
  out.reason = stop.stopped() ? stop.reason() : Reason::kDone;
  out.steps = stop.steps();
  return out;
}

}  // namespace poise
