#include "time_limits.h"

#include <algorithm>
#include <utility>

#include "problem.h"

namespace poise {
namespace {

// By multiplication alone: a power of the mathematics library may differ between boards.
double power(double base, int exponent) {
  double result = 1;
  for (int i = 0; i < exponent; ++i) result *= base;
  return result;
}

double waits(const TimeLimits::Queue& queue, double use) {
  return power(use, queue.power) / (queue.cores * (1 - use));
}

}  // namespace

double TimeLimits::slowdown(int computer, double use) const {
  const Queue& queue = queues[computer];
  if (use > kBusiest) return queue.top + queue.slope * (use - kBusiest);
  return use > 0 ? 1 + waits(queue, use) : 1.0;
}

bool TimeLimits::breaks(int i, double seconds) const {
  const Limit& each = limits[i];
  return each.price <= 0 && seconds > each.limit + kSlack * std::max(1.0, each.limit);
}

bool TimeLimits::alike(int a, int b) const {
  return latency.empty() && per_byte.empty() && speed[a] == speed[b] &&
         queues[a].cores == queues[b].cores && queues[a].power == queues[b].power;
}

void TimeLimits::set_queues(const std::vector<int>& cores, const std::vector<int>& powers) {
  for (std::size_t h = 0; h < cores.size(); ++h) {
    Queue queue{static_cast<double>(cores[h]), powers[h], 0, 0};
    const double wait = waits(queue, kBusiest);
    queue.top = 1 + wait;
    queue.slope = wait * (queue.power / kBusiest + 1 / (1 - kBusiest));
    queues.push_back(queue);
  }
}

void TimeLimits::set_own(const std::vector<double>& demand, int r) {
  for (Limit& each : limits) {
    if (each.cpu < 0) continue;
    for (Run& run : each.runs) {
      run.own = demand[static_cast<std::size_t>(run.component) * r + each.cpu];
    }
  }
}

void TimeLimits::list_units(int n) {
  std::vector<std::pair<std::int32_t, std::int32_t>> all, shared;
  for (std::int32_t i = 0; i < size(); ++i) {
    for (const Run& run : limits[i].runs) {
      all.push_back({run.unit, i});
      if (limits[i].cpu >= 0) shared.push_back({run.unit, i});
    }
    for (const Hop& hop : limits[i].hops) {
      all.push_back({hop.a, i});
      all.push_back({hop.b, i});
    }
    if (limits[i].cpu >= 0) cpus.push_back(limits[i].cpu);
  }
  const auto fill = [n](Lists<std::int32_t>& lists, auto& pairs) {
    std::sort(pairs.begin(), pairs.end());
    pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
    lists.fill(n, [&](auto add) {
      for (const auto& [unit, limit] : pairs) add(unit, limit);
    });
  };
  fill(of_unit, all);
  fill(sharing, shared);
  std::sort(cpus.begin(), cpus.end());
  cpus.erase(std::unique(cpus.begin(), cpus.end()), cpus.end());
}

TimeLimits TimeLimits::joined(const std::vector<std::int32_t>& part) const {
  TimeLimits out = *this;
  for (Limit& each : out.limits) {
    for (Run& run : each.runs) run.unit = part[run.unit];
    for (Hop& hop : each.hops) {
      hop.a = part[hop.a];
      hop.b = part[hop.b];
    }
    const auto within = [](const Hop& hop) { return hop.a == hop.b; };
    each.hops.erase(std::remove_if(each.hops.begin(), each.hops.end(), within),
                    each.hops.end());
  }
  return out;
}

}  // namespace poise
