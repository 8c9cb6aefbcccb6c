#include "problem/relaxation.h"

#include <algorithm>
#include <utility>

namespace poise {

// Demand flows where most is left, until that is level with the next, and so on. Then
// no computer has more than `level`, and the smallest residue cannot rise.
double relaxed_spread(const double* share, const double* size, int count, double open,
                    bool variance, bool alike) {
  double level = share[0], width = 0;
  int top = 0;
  for (; top < count; ++top) {
    width += size[top];
    const double next = top + 1 < count ? share[top + 1] : -kInfinity;
    const double volume = (level - next) * width;
    if (volume >= open) break;
    open -= volume;
    level = next;
  }
  level -= open / width;
  const double range = level - share[count - 1];
  if (range <= 0) return 0;
  if (!variance) return range;
  // Two residues at this distance and all others midway.
  if (!alike) return range * range / (2.0 * count);
  double sum = 0, squares = 0;
  for (int i = 0; i < count; ++i) {
    const double off = std::min(share[i], level) - level;
    sum += off;
    squares += off * off;
  }
  return squares / count - (sum / count) * (sum / count);
}

bool all_alike(const Problem& p, int k) {
  for (int h = 1; h < p.m; ++h) {
    if (p.scale[k * p.m + h] != p.scale[k * p.m]) return false;
  }
  return true;
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
  std::vector<std::pair<double, double>> sorted;
  std::vector<double> share, size;
  for (int k = 0; k < p.r; ++k) {
    if (p.weight[k] <= 0) continue;
    sorted.clear();
    share.clear();
    size.clear();
    double open = 0;
    for (int i = 0; i < p.n; ++i) open += p.demand[static_cast<std::size_t>(i) * p.r + k];
    for (int h = 0; h < p.m; ++h) {
      const double scale = p.scale[k * p.m + h];
      if (scale > 0) sorted.emplace_back(p.capacity[k * p.m + h] * scale, 1 / scale);
    }
    std::sort(sorted.rbegin(), sorted.rend());
    for (const auto& [value, unit] : sorted) {
      share.push_back(value);
      size.push_back(unit);
    }
    total += p.weight[k] * relaxed_spread(share.data(), size.data(),
                                        static_cast<int>(share.size()), open, p.variance,
                                        all_alike(p, k));
  }
  return total;
}

}  // namespace poise
