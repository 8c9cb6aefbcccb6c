#include "flow.h"

#include <algorithm>
#include <cstdlib>
#include <limits>
#include <tuple>

namespace poise::cut {
namespace {

constexpr double kTiny = 1e-9;
// How far a region reaches at first, in shares of what its blocks could take in; less and
// less while the least cut breaks a limit.
constexpr double kReaches[] = {4, 1};
// A region has at most so many nodes for each on the border.
constexpr int kDepth = 10;
constexpr int kMostRounds = 2;

}  // namespace

std::int64_t Flow::run(const Graph& graph, const std::vector<double>& limit,
                       Blocks& block) {
  graph_ = &graph;
  limit_ = &limit;
  block_ = &block;
  load_.assign(limit.size(), 0.0);
  for (int u = 0; u < graph.size(); ++u) load_[block[u]] += graph.weight[u];
  name_.assign(graph.size(), -1);
  std::int64_t saved = 0;
  std::vector<char> fresh(limit.size(), 1), stale(limit.size());
  for (int round = 0; round < kMostRounds; ++round) {
    if (!find_touches()) break;
    std::fill(stale.begin(), stale.end(), 0);
    std::vector<std::size_t> firsts;
    for (std::size_t i = 0; i < touches_.size(); ++i) {
      if (i > 0 && touches_[i].a == touches_[i - 1].a && touches_[i].b == touches_[i - 1].b) {
        continue;
      }
      if (fresh[touches_[i].a] || fresh[touches_[i].b]) firsts.push_back(i);
    }
    for (std::size_t i = firsts.size(); i > 1; --i) {
      std::swap(firsts[i - 1], firsts[random_.below(static_cast<int>(i))]);
    }
    std::int64_t now = 0;
    for (const std::size_t first : firsts) {
      if (stop_.stopped()) break;
      std::size_t last = first;
      while (last < touches_.size() && touches_[last].a == touches_[first].a &&
             touches_[last].b == touches_[first].b) {
        ++last;
      }
      for (const double reach : kReaches) {
        const std::int64_t gain = improve(first, last, reach);
        if (gain < 0) continue;  // breaks a limit
        if (gain > 0) stale[a_] = stale[b_] = 1;
        now += gain;
        break;
      }
    }
    saved += now;
    fresh = stale;
    if (now == 0) break;
  }
  return saved;
}

// List what touches another block; false when that is so much that no region is left.
bool Flow::find_touches() {
  const Graph& g = *graph_;
  const Blocks& block = *block_;
  touches_.clear();
  int border = 0;
  for (int u = 0; u < g.size(); ++u) {
    const std::size_t before = touches_.size();
    for (const Edge& e : Around(g, u)) {
      const std::int32_t a = std::min(block[u], block[e.to]);
      const std::int32_t b = std::max(block[u], block[e.to]);
      if (a == b) continue;
      const bool known = touches_.size() > before && touches_.back().a == a &&
                         touches_.back().b == b;
      if (!known) touches_.push_back({a, b, u});
    }
    border += touches_.size() > before;
    if (2 * border > g.size()) return false;
  }
  stop_.after(g.size() / 8 + 1);
  std::sort(touches_.begin(), touches_.end(), [](const Touch& x, const Touch& y) {
    return std::tie(x.a, x.b, x.node) < std::tie(y.a, y.b, y.node);
  });
  return true;
}

// Returns what was saved, or -1 when the least cut would break a limit.
std::int64_t Flow::improve(std::size_t first, std::size_t last, double reach) {
  a_ = touches_[first].a;
  b_ = touches_[first].b;
  std::int64_t saved = 0;
  if (gather(first, last, reach)) {
    connect();
    const std::int64_t least = fill();
    if (least < now_ || (least == now_ && reach > kReaches[1])) {
      saved = divide() ? now_ - least : -1;
    }
  }
  stop_.after(static_cast<std::int64_t>(nodes_.size()) + 1);
  for (const std::int32_t u : nodes_) name_[u] = -1;
  return saved;
}

// Take what touches, and what lies about it, as long as either block could take it in.
bool Flow::gather(std::size_t first, std::size_t last, double reach) {
  const Graph& g = *graph_;
  const Blocks& block = *block_;
  nodes_.clear();
  double room[2];
  for (const int side : {0, 1}) {
    const std::int32_t other = side == 0 ? b_ : a_, mine = side == 0 ? a_ : b_;
    const double all = load_[a_] + load_[b_];
    const double limits = (*limit_)[a_] + (*limit_)[b_];
    const double even = all * (*limit_)[other] / limits;
    room[side] = even + reach * std::max(0.0, (*limit_)[other] - even) - load_[other];
    room[side] = std::min(room[side], 0.9 * load_[mine]);
  }
  const auto take = [&](std::int32_t u) {
    if (name_[u] >= 0) return;
    const int side = block[u] == a_ ? 0 : 1;
    if (g.weight[u] > room[side]) return;
    room[side] -= g.weight[u];
    name_[u] = static_cast<std::int32_t>(nodes_.size());
    nodes_.push_back(u);
  };
  for (std::size_t i = first; i < last; ++i) {
    const std::int32_t u = touches_[i].node;
    if (block[u] == a_ || block[u] == b_) take(u);
  }
  const std::size_t most = kDepth * nodes_.size();
  for (std::size_t i = 0; i < nodes_.size() && nodes_.size() < most; ++i) {
    for (const Edge& e : Around(g, nodes_[i])) {
      if (block[e.to] == a_ || block[e.to] == b_) take(e.to);
    }
  }
  return nodes_.size() > 1;
}

// Set up the network: arcs within the region, and what comes from a and goes to b.
void Flow::connect() {
  const Graph& g = *graph_;
  const Blocks& block = *block_;
  const std::size_t count = nodes_.size();
  source_.assign(count, 0);
  sink_.assign(count, 0);
  start_.assign(count + 1, 0);
  now_ = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const std::int32_t u = nodes_[i];
    std::int32_t inside = 0;
    for (const Edge& e : Around(g, u)) {
      const std::int32_t there = block[e.to];
      if (there != a_ && there != b_) continue;
      const bool cut = there != block[u];
      if (name_[e.to] >= 0) {
        ++inside;
        if (cut && e.to > u) now_ += e.weight;
        continue;
      }
      (there == a_ ? source_ : sink_)[i] += e.weight;
      if (cut) now_ += e.weight;
    }
    start_[i + 1] = start_[i] + inside;
  }
  arcs_.resize(start_[count]);
  next_.assign(start_.begin(), start_.end() - 1);
  for (std::size_t i = 0; i < count; ++i) {
    for (const Edge& e : Around(g, nodes_[i])) {
      const std::int32_t j = name_[e.to];
      if (j <= static_cast<std::int32_t>(i)) continue;
      const std::int32_t there = next_[i]++, back = next_[j]++;
      arcs_[there] = {j, back, e.weight};
      arcs_[back] = {static_cast<std::int32_t>(i), there, e.weight};
    }
  }
}

// Dinic's maximal flow; returns its size, which is what the least cut weighs.
std::int64_t Flow::fill() {
  const auto count = static_cast<std::int32_t>(nodes_.size());
  std::int64_t flow = 0;
  for (std::int32_t i = 0; i < count; ++i) {
    const std::int32_t direct = std::min(source_[i], sink_[i]);
    source_[i] -= direct;
    sink_[i] -= direct;
    flow += direct;
  }
  while (level_nodes()) {
    std::copy(start_.begin(), start_.end() - 1, next_.begin());
    for (std::int32_t i = 0; i < count; ++i) {
      while (source_[i] > 0) {
        const std::int32_t sent = augment(i);
        if (sent == 0) break;
        flow += sent;
      }
    }
  }
  return flow;
}

// How far each node is from where something can still come; false when no way is left.
bool Flow::level_nodes() {
  level_.assign(nodes_.size(), -1);
  queue_.clear();
  for (std::size_t i = 0; i < nodes_.size(); ++i) {
    if (source_[i] <= 0) continue;
    level_[i] = 0;
    queue_.push_back(static_cast<std::int32_t>(i));
  }
  for (std::size_t q = 0; q < queue_.size(); ++q) {
    const std::int32_t i = queue_[q];
    if (sink_[i] > 0) return true;
    for (std::int32_t e = start_[i]; e < start_[i + 1]; ++e) {
      const Arc& arc = arcs_[e];
      if (arc.left <= 0 || level_[arc.to] >= 0) continue;
      level_[arc.to] = level_[i] + 1;
      queue_.push_back(arc.to);
    }
  }
  return false;
}

// Send what one way from `from` can carry.
std::int32_t Flow::augment(std::int32_t from) {
  path_.clear();  // the arcs of the way so far
  std::int32_t at = from;
  while (true) {
    if (sink_[at] > 0) {
      std::int32_t sent = std::min(source_[from], sink_[at]);
      for (const std::int32_t e : path_) sent = std::min(sent, arcs_[e].left);
      for (const std::int32_t e : path_) {
        arcs_[e].left -= sent;
        arcs_[arcs_[e].back].left += sent;
      }
      source_[from] -= sent;
      sink_[at] -= sent;
      return sent;
    }
    bool on = false;
    for (std::int32_t& e = next_[at]; e < start_[at + 1]; ++e) {
      const Arc& arc = arcs_[e];
      if (arc.left <= 0 || level_[arc.to] != level_[at] + 1) continue;
      path_.push_back(e);
      at = arc.to;
      on = true;
      break;
    }
    if (on) continue;
    if (path_.empty()) return 0;
    level_[at] = -1;
    at = arcs_[arcs_[path_.back()].back].to;
    path_.pop_back();
    ++next_[at];
  }
}

void Flow::reach_from(std::int32_t node) {
  queue_.clear();
  queue_.push_back(node);
  at_a_[node] = 1;
  for (std::size_t q = 0; q < queue_.size(); ++q) {
    for (std::int32_t e = start_[queue_[q]]; e < start_[queue_[q] + 1]; ++e) {
      if (arcs_[e].left <= 0 || at_a_[arcs_[e].to]) continue;
      at_a_[arcs_[e].to] = 1;
      queue_.push_back(arcs_[e].to);
    }
  }
}

// Take the least cut that loads the two most evenly; false when all break a limit.
bool Flow::divide() {
  const Graph& g = *graph_;
  Blocks& block = *block_;
  const std::size_t count = nodes_.size();
  const double limit_a = (*limit_)[a_], limit_b = (*limit_)[b_];
  double load_a = load_[a_];
  const double all = load_[a_] + load_[b_];
  for (const std::int32_t u : nodes_) load_a -= block[u] == a_ ? g.weight[u] : 0.0;
  const auto fullest = [&](double a) { return std::max(a / limit_a, (all - a) / limit_b); };
  // What can still be reached from a is on its side in every least cut...
  at_a_.assign(count, 0);
  std::vector<std::int32_t> order;
  const auto add = [&](std::int32_t i) {
    reach_from(i);
    for (const std::int32_t j : queue_) {
      load_a += g.weight[nodes_[j]];
      order.push_back(j);
    }
  };
  for (std::size_t i = 0; i < count; ++i) {
    if (source_[i] > 0 && !at_a_[i]) add(static_cast<std::int32_t>(i));
  }
  // ... what can still reach b never is, and the rest may come with all it can reach.
  std::vector<char> at_b(count, 0);
  std::vector<std::int32_t> list;
  for (std::size_t i = 0; i < count; ++i) {
    if (sink_[i] <= 0) continue;
    at_b[i] = 1;
    list.push_back(static_cast<std::int32_t>(i));
  }
  for (std::size_t q = 0; q < list.size(); ++q) {
    for (std::int32_t e = start_[list[q]]; e < start_[list[q] + 1]; ++e) {
      const Arc& arc = arcs_[e];
      if (at_b[arc.to] || arcs_[arc.back].left <= 0) continue;
      at_b[arc.to] = 1;
      list.push_back(arc.to);
    }
  }
  double best = fullest(load_a), best_load = load_a;
  std::size_t keep = order.size();
  for (std::size_t i = 0; i < count && load_a / limit_a < (all - load_a) / limit_b; ++i) {
    if (at_a_[i] || at_b[i]) continue;
    add(static_cast<std::int32_t>(i));
    if (fullest(load_a) >= best) continue;
    best = fullest(load_a);
    best_load = load_a;
    keep = order.size();
  }
  // Limits that are broken already may stay so, if it gets no worse.
  if (best > std::max(1 + kTiny, fullest(load_[a_]))) return false;
  for (std::size_t q = keep; q < order.size(); ++q) at_a_[order[q]] = 0;
  for (std::size_t i = 0; i < count; ++i) block[nodes_[i]] = at_a_[i] ? a_ : b_;
  load_[a_] = best_load;
  load_[b_] = all - best_load;
  return true;
}

}  // namespace poise::cut
