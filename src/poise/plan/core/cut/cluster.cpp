// Which nodes become one: those that hold to each other most for their size.
#include <algorithm>
#include <numeric>

#include "graph.h"

namespace poise::cut {
namespace {

// Visited in random blocks of consecutive nodes: nearly as random as a full shuffle, and
// far fewer cache misses.
constexpr int kRun = 32;

std::vector<std::int32_t> shuffled_runs(int n, Random& random) {
  std::vector<std::int32_t> runs((n + kRun - 1) / kRun);
  std::iota(runs.begin(), runs.end(), 0);
  for (std::size_t i = runs.size(); i > 1; --i) {
    std::swap(runs[i - 1], runs[random.below(static_cast<int>(i))]);
  }
  return runs;
}

}  // namespace

Clusters cluster(const Graph& g, const Blocks& group, double heaviest, Random& random) {
  const int n = g.size();
  std::vector<std::int32_t> leader(n);
  std::iota(leader.begin(), leader.end(), 0);
  std::vector<double> weight = g.weight;
  std::vector<char> alone(n, 1);
  std::vector<std::int32_t> tie(n, 0), near;
  const auto visit = [&](int u) {
    near.clear();
    for (const Edge& e : Around(g, u)) {
      if (!group.empty() && group[e.to] != group[u]) continue;
      const std::int32_t c = leader[e.to];
      if (tie[c] == 0) near.push_back(c);
      tie[c] += e.weight;
    }
    int best = -1;
    double most = 0;
    for (const std::int32_t c : near) {
      const double ties = tie[c];
      tie[c] = 0;
      if (weight[c] + weight[u] > heaviest) continue;
      const double rating = ties * ties / (weight[c] + 1e-12);
      if (rating < most || (rating == most && (random.next() & 1) != 0)) continue;
      most = rating;
      best = c;
    }
    if (best < 0) return;
    leader[u] = best;
    weight[best] += weight[u];
    alone[u] = alone[best] = 0;
  };
  for (const std::int32_t run : shuffled_runs(n, random)) {
    const int end = std::min(n, (run + 1) * kRun);
    for (int u = run * kRun; u < end; ++u) {
      if (alone[u]) visit(u);
    }
  }
  // Number the clusters by their first node: neighbours stay near in memory.
  Clusters out{std::vector<std::int32_t>(n, -1), 0};
  std::vector<std::int32_t> number(n, -1);
  for (int u = 0; u < n; ++u) {
    std::int32_t& mine = number[leader[u]];
    if (mine < 0) mine = out.count++;
    out.of[u] = mine;
  }
  return out;
}

}  // namespace poise::cut
