// Graphs to be cut into blocks of limited weight, and how they are made smaller.
#pragma once

#include <cstdint>
#include <vector>

#include "../random.h"

namespace poise::cut {

struct Edge {
  std::int32_t to, weight;
};

using Blocks = std::vector<std::int32_t>;  // node -> block

// Undirected: each edge stands at both ends. All edge weights together are below 2^30,
// so that any sum of them is a 32-bit number.
struct Graph {
  std::vector<std::int32_t> start{0};
  std::vector<Edge> edges;
  std::vector<double> weight;

  int size() const { return static_cast<int>(weight.size()); }
  const Edge* begin(int node) const { return edges.data() + start[node]; }
  const Edge* end(int node) const { return edges.data() + start[node + 1]; }
  double total() const;        // of all nodes
  double edge_weight() const;  // of all edges, each counted once
};

// The neighbours of a node, for range-for.
struct Around {
  const Edge *first, *last;
  Around(const Graph& g, int node) : first(g.begin(node)), last(g.end(node)) {}
  const Edge* begin() const { return first; }
  const Edge* end() const { return last; }
};

// Twice the weight of all edges between blocks, halved.
std::int64_t cut_of(const Graph& graph, const Blocks& block);

// What nodes become one: node -> cluster. Only nodes of the same group may join (an empty
// `group` is one group), and no cluster of several gets heavier than `heaviest`.
struct Clusters {
  std::vector<std::int32_t> of;
  int count = 0;
};
Clusters cluster(const Graph& graph, const Blocks& group, double heaviest, Random& random);

// Make each cluster one node; edges between the same two add up.
Graph contract(const Graph& graph, const Clusters& clusters);

// The part of a graph that lies in one block; `nodes` gets who they were.
Graph extract(const Graph& graph, const Blocks& block, int which,
              std::vector<std::int32_t>& nodes);

// A graph and ever smaller ones made of it.
class Levels {
 public:
  // Join until `enough` nodes are left, or no more can be joined.
  Levels(const Graph& graph, const Blocks& group, int enough, double heaviest,
         Random& random);

  int count() const { return static_cast<int>(smaller_.size()) + 1; }
  const Graph& at(int level) const { return level == 0 ? graph_ : smaller_[level - 1]; }
  const Graph& smallest() const { return at(count() - 1); }
  // A division of level 0 that no cluster straddles, as one of the smallest level.
  Blocks down(Blocks block) const;
  // From `level` to the one below, which is larger.
  Blocks up(int level, const Blocks& block) const;

 private:
  const Graph& graph_;
  std::vector<Graph> smaller_;
  std::vector<Clusters> clusters_;
};

}  // namespace poise::cut
