#include "relaxation.h"

#include "times.h"

namespace poise {
namespace {

double demand_of(const Problem& p, int k) {
  double total = 0;
  for (int i = 0; i < p.n; ++i) total += p.need(i)[k];
  return total;
}

}  // namespace

Levelling::Levelling(const Problem& p, int k) : size(p.m, 0.0) {
  double left = -demand_of(p, k), width = 0;
  for (int h = 0; h < p.m; ++h) {
    const double scale = p.scale[k * p.m + h];
    alike &= scale == p.scale[k * p.m];
    if (scale <= 0) continue;
    size[h] = 1 / scale;
    width += size[h];
    left += p.capacity[k * p.m + h];
  }
  level = width > 0 ? left / width : 0.0;
}

double relaxation_bound(const Problem& p) {
  double total = 0;
  for (int i = 0; i < p.n && !p.cost.empty(); ++i) {
    double least = kInfinity;
    for (int h = 0; h < p.m; ++h) {
      if (p.allowed(i, h)) least = std::min(least, p.linear(i, h));
    }
    total += least;
  }
  for (const int k : p.priced) {
    total += p.price[k] * relaxed_shortage(p, k, &p.capacity[k * p.m], demand_of(p, k));
  }
  std::vector<double> share(p.m);
  for (int k = 0; k < p.r; ++k) {
    if (p.weight[k] <= 0) continue;
    const Levelling levelling(p, k);
    for (int h = 0; h < p.m; ++h) share[h] = p.capacity[k * p.m + h] * p.scale[k * p.m + h];
    total += p.weight[k] * relaxed_spread(share.data(), levelling.size.data(), p.m,
                                          p.counted[k], levelling.level, demand_of(p, k),
                                          p.variance, levelling.alike);
  }
  if (p.time_limits) total += time_sum(p, Placement(p.n, -1), p.capacity).paid;
  return total;
}

}  // namespace poise
