#include "graph.h"

#include <algorithm>
#include <numeric>

namespace poise::cut {
namespace {

// From one level to the next, fewer nodes than this share are worth a level.
constexpr double kWorthwhile = 0.95;

}  // namespace

double Graph::total() const { return std::accumulate(weight.begin(), weight.end(), 0.0); }

double Graph::edge_weight() const {
  double twice = 0;
  for (const Edge& e : edges) twice += e.weight;
  return twice / 2;
}

std::int64_t cut_of(const Graph& g, const Blocks& block) {
  std::int64_t twice = 0;
  for (int u = 0; u < g.size(); ++u) {
    for (const Edge& e : Around(g, u)) twice += block[u] != block[e.to] ? e.weight : 0;
  }
  return twice / 2;
}

Graph contract(const Graph& g, const Clusters& clusters) {
  const int n = g.size(), count = clusters.count;
  const std::vector<std::int32_t>& of = clusters.of;
  std::vector<std::int32_t> first(count + 1, 0), members(n);
  for (int u = 0; u < n; ++u) ++first[of[u] + 1];
  std::partial_sum(first.begin(), first.end(), first.begin());
  std::vector<std::int32_t> next(first.begin(), first.end() - 1);
  for (int u = 0; u < n; ++u) members[next[of[u]]++] = u;
  Graph out;
  out.weight.assign(count, 0.0);
  out.start.assign(count + 1, 0);
  out.edges.resize(g.edges.size());
  std::vector<std::int32_t> seen(count, -1);
  std::int32_t end = 0;
  for (int c = 0; c < count; ++c) {
    const std::int32_t begin = end;
    for (std::int32_t i = first[c]; i < first[c + 1]; ++i) {
      out.weight[c] += g.weight[members[i]];
      for (const Edge& e : Around(g, members[i])) {
        const std::int32_t to = of[e.to];
        if (to == c) continue;
        if (seen[to] >= begin) {
          out.edges[seen[to]].weight += e.weight;
        } else {
          seen[to] = end;
          out.edges[end++] = {to, e.weight};
        }
      }
    }
    out.start[c + 1] = end;
  }
  out.edges.resize(end);
  return out;
}

Graph extract(const Graph& g, const Blocks& block, int which,
              std::vector<std::int32_t>& nodes) {
  nodes.clear();
  std::vector<std::int32_t> name(g.size(), -1);
  for (int u = 0; u < g.size(); ++u) {
    if (block[u] != which) continue;
    name[u] = static_cast<std::int32_t>(nodes.size());
    nodes.push_back(u);
  }
  Graph out;
  for (const std::int32_t u : nodes) {
    out.weight.push_back(g.weight[u]);
    for (const Edge& e : Around(g, u)) {
      if (name[e.to] >= 0) out.edges.push_back({name[e.to], e.weight});
    }
    out.start.push_back(static_cast<std::int32_t>(out.edges.size()));
  }
  return out;
}

Levels::Levels(const Graph& graph, const Blocks& group, int enough, double heaviest,
               Random& random)
    : graph_(graph) {
  Blocks mine = group;
  smaller_.reserve(64);
  while (smallest().size() > enough && smaller_.size() < 60) {
    Clusters found = cluster(smallest(), mine, heaviest, random);
    if (found.count > kWorthwhile * smallest().size()) break;
    Blocks coarse(mine.empty() ? 0 : found.count);
    for (std::size_t u = 0; u < mine.size(); ++u) coarse[found.of[u]] = mine[u];
    mine = std::move(coarse);
    smaller_.push_back(contract(smallest(), found));
    clusters_.push_back(std::move(found));
  }
}

Blocks Levels::down(Blocks block) const {
  for (const Clusters& clusters : clusters_) {
    Blocks coarse(clusters.count);
    for (std::size_t u = 0; u < block.size(); ++u) coarse[clusters.of[u]] = block[u];
    block = std::move(coarse);
  }
  return block;
}

Blocks Levels::up(int level, const Blocks& block) const {
  const std::vector<std::int32_t>& of = clusters_[level - 1].of;
  Blocks finer(of.size());
  for (std::size_t u = 0; u < of.size(); ++u) finer[u] = block[of[u]];
  return finer;
}

}  // namespace poise::cut
