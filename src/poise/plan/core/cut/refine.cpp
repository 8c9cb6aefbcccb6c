#include "refine.h"

#include <algorithm>

namespace poise::cut {
namespace {

constexpr int kMostRounds = 10, kMostRoundsOfAll = 3;
// A round that saves less than this share of what the first one saved is the last.
constexpr double kWorthwhile = 0.15;
// From this many nodes a search starts, and after so many moves without a new best it ends.
constexpr int kSeeds = 10, kPatience = 30;
// From all of the border; then a part of the nodes, if that is more.
constexpr int kSeedsOfAll = 1 << 30, kPatienceOfAll = 500, kPatiencePart = 50;
constexpr double kTiny = 1e-9;

}  // namespace

void Refiner::run(const Graph& graph, const std::vector<double>& limit, Blocks& block) {
  graph_ = &graph;
  limit_ = &limit;
  block_ = &block;
  const auto k = limit.size();
  tie_.assign(k, 0);
  load_.assign(k, 0.0);
  for (int u = 0; u < graph.size(); ++u) load_[block[u]] += graph.weight[u];
  queue_.fit(graph.size());
  if (static_cast<int>(moved_.size()) < graph.size()) {
    moved_.resize(graph.size(), 0);
    listed_.resize(graph.size(), 0);
  }
  count_ties();
  relieve();
  border_.clear();
  beside_.clear();
  std::int64_t first = 0;
  for (int i = 0; i < kMostRounds && !stop_.stopped(); ++i) {
    // Where nearly all is border, one search from all of it does the most.
    const bool all = i == 0 || 2 * static_cast<int>(border_.size()) > graph.size();
    const std::int64_t saved =
        all ? round(kSeedsOfAll, std::max(kPatienceOfAll, graph.size() / kPatiencePart))
            : round(kSeeds, kPatience);
    if (i == 0) first = saved;
    if (i > 0 && saved <= kWorthwhile * first) break;
    if (all && i + 1 >= kMostRoundsOfAll) break;
  }
}

double Refiner::excess(const Graph& g, const std::vector<double>& limit,
                       const Blocks& block) {
  std::vector<double> load(limit.size(), 0.0);
  for (int u = 0; u < g.size(); ++u) load[block[u]] += g.weight[u];
  double total = 0;
  for (std::size_t b = 0; b < limit.size(); ++b) {
    total += std::max(0.0, load[b] - limit[b] * (1 + kTiny));
  }
  return total;
}

bool Refiner::on_border(int node) const {
  const std::int32_t here = (*block_)[node];
  for (const Edge& e : Around(*graph_, node)) {
    if ((*block_)[e.to] != here) return true;
  }
  return false;
}

// Where there are many neighbours it is quicker to look up ties than to add them up: hubs
// come to the top of the queue again and again.
void Refiner::count_ties() {
  const Graph& g = *graph_;
  const auto k = static_cast<std::int32_t>(limit_->size());
  row_.assign(g.size(), -1);
  ties_.clear();
  for (int u = 0; u < g.size(); ++u) {
    if (2 * (g.start[u + 1] - g.start[u]) < k) continue;
    row_[u] = static_cast<std::int32_t>(ties_.size());
    ties_.resize(ties_.size() + k, 0);
    for (const Edge& e : Around(g, u)) ties_[row_[u] + (*block_)[e.to]] += e.weight;
  }
}

// The block that a node had best go to; `within` the blocks' limits, and only to blocks
// it has ties to. `to` is -1 when there is none.
Refiner::Best Refiner::best(int node, bool within) {
  const Blocks& block = *block_;
  const std::int32_t here = block[node];
  Best out{-1, 0};
  double room = 0;
  const auto weigh = [&](std::int32_t b, std::int32_t gain) {
    if (out.to >= 0 && gain < out.gain) return;
    const double left = (*limit_)[b] * (1 + kTiny) - load_[b] - graph_->weight[node];
    if (within && left < 0) return;
    if (out.to >= 0 && gain == out.gain && left <= room) return;
    out = {b, gain};
    room = left;
  };
  if (row_[node] >= 0) {
    const std::int32_t* ties = &ties_[row_[node]];
    const auto k = static_cast<std::int32_t>(limit_->size());
    for (std::int32_t b = 0; b < k; ++b) {
      if (ties[b] > 0 && b != here) weigh(b, ties[b] - ties[here]);
    }
    return out;
  }
  near_.clear();
  for (const Edge& e : Around(*graph_, node)) {
    const std::int32_t there = block[e.to];
    if (tie_[there] == 0) near_.push_back(there);
    tie_[there] += e.weight;
  }
  const std::int32_t stays = tie_[here];
  for (const std::int32_t b : near_) {
    const std::int32_t gain = tie_[b] - stays;
    tie_[b] = 0;
    if (b != here) weigh(b, gain);
  }
  return out;
}

void Refiner::move(int node, int to) {
  std::int32_t& block = (*block_)[node];
  load_[block] -= graph_->weight[node];
  load_[to] += graph_->weight[node];
  for (const Edge& e : Around(*graph_, node)) {
    const std::int32_t row = row_[e.to];
    if (row < 0) continue;
    ties_[row + block] -= e.weight;
    ties_[row + to] += e.weight;
  }
  block = to;
}

// Of the neighbours of a node that was moved, bring the gains up to date. Those in the
// queue get what theirs can have become at most: it is worked out when it comes to the top.
void Refiner::tell_neighbours(int node, int from, int to) {
  // Of two blocks, what one gains the other loses.
  const std::int32_t loss = limit_->size() == 2 ? -2 : -1;
  for (const Edge& e : Around(*graph_, node)) {
    if (moved_[e.to] == round_) continue;
    const std::int32_t here = (*block_)[e.to];
    if (!queue_.holds(e.to)) push(e.to);
    else if (here == from) queue_.add(e.to, 2 * e.weight);
    else queue_.add(e.to, here == to ? loss * e.weight : e.weight);
  }
}

void Refiner::push(int node) {
  const Best found = best(node, true);
  if (found.to >= 0) queue_.set(node, found.gain);
  else queue_.remove(node);
}

// Take nodes from blocks over their limit, the cheapest first, to blocks with room.
void Refiner::relieve() {
  const Graph& g = *graph_;
  const auto over = [&](int b) { return load_[b] > (*limit_)[b] * (1 + kTiny); };
  const int k = static_cast<int>(load_.size());
  for (int from = 0; from < k; ++from) {
    if (!over(from)) continue;
    for (int u = 0; u < g.size(); ++u) {
      if ((*block_)[u] == from) queue_.set(u, best(u, true).gain);
    }
    while (over(from) && !queue_.empty()) {
      const int u = queue_.top();
      queue_.remove(u);
      Best found = best(u, true);
      if (!queue_.empty() && found.to >= 0 && found.gain < queue_.gain()) {
        queue_.set(u, found.gain);
        continue;
      }
      if (found.to < 0) {
        // To wherever most room is.
        double room = 0;
        for (int b = 0; b < k; ++b) {
          const double left = (*limit_)[b] - load_[b] - g.weight[u];
          if (b != from && left > room) {
            room = left;
            found.to = b;
          }
        }
        if (found.to < 0) continue;
      }
      move(u, found.to);
      for (const Edge& e : Around(g, u)) {
        if (queue_.holds(e.to)) queue_.set(e.to, best(e.to, true).gain);
      }
    }
    queue_.clear();
  }
}

// Find the border: at first among all nodes, then among what was on it and about what was
// moved.
void Refiner::find_border() {
  ++round_;
  if (border_.empty()) {
    for (int u = 0; u < graph_->size(); ++u) border_.push_back(u);
    stop_.after(graph_->size() / 8 + 1);
  }
  border_.insert(border_.end(), beside_.begin(), beside_.end());
  beside_.clear();
  const auto inner = [&](int u) { return !on_border(u); };
  border_.erase(std::remove_if(border_.begin(), border_.end(), inner), border_.end());
  for (const std::int32_t u : border_) listed_[u] = round_;
  stop_.after(static_cast<std::int64_t>(border_.size()) / 8 + 1);
}

void Refiner::list(int node) {
  if (listed_[node] == round_) return;
  listed_[node] = round_;
  beside_.push_back(node);
}

// Search from every node on the border, `seeds` at a time; returns what that saved.
std::int64_t Refiner::round(int seeds, int patience) {
  find_border();
  for (std::size_t i = border_.size(); i > 1; --i) {
    std::swap(border_[i - 1], border_[random_.below(static_cast<int>(i))]);
  }
  std::int64_t saved = 0;
  for (std::size_t i = 0; i < border_.size() && !stop_.stopped();) {
    int taken = 0;
    for (; i < border_.size() && taken < seeds; ++i) {
      if (moved_[border_[i]] == round_) continue;
      push(border_[i]);
      ++taken;
    }
    saved += search(patience);
  }
  return saved;
}

std::int64_t Refiner::search(int patience) {
  moves_.clear();
  std::int64_t saved = 0, most = 0;
  std::size_t keep = 0;
  while (!queue_.empty() && moves_.size() < keep + patience && !stop_.after(1)) {
    const int u = queue_.top();
    const std::int32_t hoped = queue_.gain();
    queue_.remove(u);
    const Best found = best(u, true);
    if (found.to < 0) continue;
    if (found.gain < hoped) {
      queue_.set(u, found.gain);
      continue;
    }
    const std::int32_t from = (*block_)[u];
    moves_.push_back({u, from});
    move(u, found.to);
    moved_[u] = round_;
    saved += found.gain;
    if (saved > most) {
      most = saved;
      keep = moves_.size();
    }
    tell_neighbours(u, from, found.to);
  }
  queue_.clear();
  while (moves_.size() > keep) {
    move(moves_.back().node, moves_.back().from);
    moves_.pop_back();
  }
  for (const Move& kept : moves_) {
    list(kept.node);
    for (const Edge& e : Around(*graph_, kept.node)) list(e.to);
  }
  return most;
}

}  // namespace poise::cut
