#include "bisect.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "flow.h"

namespace poise::cut {
namespace {

// So few nodes are left when two halves are first made, and so often it is tried.
constexpr int kFew = 60, kTries = 8;
// Which part of the effort goes into trying halvings again; and which part of the edges a
// halving cuts at most for that to be worth it: where it cuts more, all are alike.
constexpr double kRetry = 0.3, kShapeless = 0.2;
// What a joined node may weigh, of the lighter half.
constexpr double kHeaviest = 0.06;
constexpr double kTiny = 1e-9;

// A division into two, and how good it is.
struct Halves {
  Halves() = default;
  Halves(const Graph& graph, const std::vector<double>& most, Blocks found)
      : block(std::move(found)), cut(cut_of(graph, block)),
        over(Refiner::excess(graph, most, block)) {}
  bool better_than(const Halves& other) const {
    return over != other.over ? over < other.over : cut < other.cut;
  }
  Blocks block;
  std::int64_t cut = 0;
  double over = 0;
};

class Bisection {
 public:
  Bisection(const std::vector<double>& limit, int tries, Stop& stop, Random& random)
      : limit_(limit), tries_(tries), stop_(stop), random_(random),
        refiner_(stop, random), flow_(stop, random) {}

  // Give the nodes of `graph`, called `nodes` in the whole, the blocks [first, last).
  void divide(const Graph& graph, const std::vector<std::int32_t>& nodes, int first,
              int last, Blocks& out) {
    if (last - first == 1) {
      for (const std::int32_t u : nodes) out[u] = first;
      return;
    }
    const int middle = first + (last - first) / 2;
    const auto begin = limit_.begin();
    const double room[2] = {std::accumulate(begin + first, begin + middle, 0.0),
                            std::accumulate(begin + middle, begin + last, 0.0)};
    const double total = graph.total(), all = room[0] + room[1];
    // What may go wrong now must leave the halves of the halves their share.
    const double depth = std::ceil(std::log2(last - first));
    const double slack = std::pow(std::max(1.0, all / total), 1 / depth);
    std::vector<double> most(2), aim(2);
    for (const int side : {0, 1}) {
      aim[side] = total * room[side] / all;
      most[side] = std::min(aim[side] * slack, std::max(room[side], aim[side]));
    }
    const Halves halves = best_halves(graph, aim, most, last - first);
    for (const int side : {0, 1}) {
      std::vector<std::int32_t> mine;
      const Graph half = extract(graph, halves.block, side, mine);
      for (std::int32_t& u : mine) u = nodes[u];
      divide(half, mine, side == 0 ? first : middle, side == 0 ? middle : last, out);
    }
  }

 private:
  // The best of several, as long as `blocks` of all blocks have not had their share of time.
  Halves best_halves(const Graph& graph, const std::vector<double>& aim,
                     const std::vector<double>& most, int blocks) {
    const auto k = static_cast<double>(limit_.size());
    const double until = stop_.spent() + kRetry * blocks / k / std::ceil(std::log2(k));
    Halves best = halve(graph, aim, most);
    const double shapeless = kShapeless * graph.edge_weight();
    for (int i = 1; i < tries_ && stop_.spent() < until; ++i) {
      if (static_cast<double>(best.cut) > shapeless) break;
      Halves other = halve(graph, aim, most);
      if (other.better_than(best)) best = std::move(other);
    }
    return best;
  }

  Halves halve(const Graph& graph, const std::vector<double>& aim,
               const std::vector<double>& most) {
    const Levels levels(graph, {}, kFew, kHeaviest * std::min(aim[0], aim[1]), random_);
    const Graph& smallest = levels.smallest();
    Halves best;
    for (int i = 0; i < kTries; ++i) {
      Blocks block = grown(smallest, aim[1]);
      refiner_.run(smallest, most, block);
      Halves found(smallest, most, std::move(block));
      if (best.block.empty() || found.better_than(best)) best = std::move(found);
    }
    Blocks block = std::move(best.block);
    for (int level = levels.count() - 1; level > 0; --level) {
      block = levels.up(level, block);
      const Graph& finer = levels.at(level - 1);
      refiner_.run(finer, most, block);
      if (flow_.run(finer, most, block) > 0) refiner_.run(finer, most, block);
    }
    return Halves(graph, most, std::move(block));
  }

  // Block 1 grows from a random node, by what is tied to it most, until it weighs `aim`.
  Blocks grown(const Graph& g, double aim) {
    const int n = g.size();
    Blocks block(n, 0);
    queue_.fit(n);
    double weight = 0;
    // Nodes that are too heavy may be met again.
    for (int tries = 2 * n; weight + kTiny < aim && tries > 0; --tries) {
      if (queue_.empty()) {
        int u = random_.below(n);
        while (block[u] == 1) u = u + 1 < n ? u + 1 : 0;
        queue_.set(u, 0);
      }
      const int u = queue_.top();
      queue_.remove(u);
      if (weight + g.weight[u] / 2 > aim && weight > 0) continue;
      block[u] = 1;
      weight += g.weight[u];
      for (const Edge& e : Around(g, u)) {
        if (block[e.to] == 1) continue;
        std::int32_t gain = 0;
        for (const Edge& f : Around(g, e.to)) {
          gain += block[f.to] == 1 ? f.weight : -f.weight;
        }
        queue_.set(e.to, gain);
      }
    }
    queue_.clear();
    return block;
  }

  const std::vector<double>& limit_;
  int tries_;
  Stop& stop_;
  Random& random_;
  Refiner refiner_;
  Flow flow_;
  Queue queue_;
};

}  // namespace

Blocks bisect(const Graph& graph, const std::vector<double>& limit, int tries, Stop& stop,
              Random& random) {
  Blocks out(graph.size(), 0);
  std::vector<std::int32_t> nodes(graph.size());
  std::iota(nodes.begin(), nodes.end(), 0);
  const auto blocks = static_cast<int>(limit.size());
  Bisection(limit, tries, stop, random).divide(graph, nodes, 0, blocks, out);
  return out;
}

}  // namespace poise::cut
