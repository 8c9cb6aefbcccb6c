// Moving nodes between blocks so that less is cut, while each block keeps its limit.
#pragma once

#include "../stop.h"
#include "graph.h"
#include "queue.h"

namespace poise::cut {

// Fiduccia and Mattheyses' search on k blocks, each time from a few nodes on the border:
// the best move is made even if it cuts more, and all moves after the best moment are
// taken back when nothing better came of them. A node is moved once a round.
class Refiner {
 public:
  Refiner(Stop& stop, Random& random) : stop_(stop), random_(random) {}

  // Make `block` better for `limit`; blocks over their limit are relieved first.
  void run(const Graph& graph, const std::vector<double>& limit, Blocks& block);
  // By how much blocks of `block` are over their limits.
  static double excess(const Graph& graph, const std::vector<double>& limit,
                       const Blocks& block);

 private:
  struct Best {
    int to;
    std::int32_t gain;
  };
  struct Move {
    std::int32_t node, from;
  };

  void count_ties();
  void find_border();
  void relieve();
  std::int64_t round(int seeds, int patience);
  std::int64_t search(int patience);
  Best best(int node, bool within);
  void push(int node);
  void tell_neighbours(int node, int from, int to);
  void move(int node, int to);
  bool on_border(int node) const;
  void list(int node);

  Stop& stop_;
  Random& random_;
  const Graph* graph_ = nullptr;
  const std::vector<double>* limit_ = nullptr;
  Blocks* block_ = nullptr;
  Queue queue_;
  std::vector<double> load_;
  std::vector<std::int32_t> tie_, near_;  // of the node at hand, by block
  // What nodes with at least half as many neighbours as there are blocks are tied to each
  // block; and where that begins for each node, -1 for those with fewer.
  std::vector<std::int32_t> ties_, row_;
  // The border, and what may have come to it in this round; when each was listed last.
  std::vector<std::int32_t> border_, beside_;
  std::vector<std::uint32_t> listed_;
  std::vector<std::uint32_t> moved_;  // the last round in which each node was moved
  std::uint32_t round_ = 0;
  std::vector<Move> moves_;
};

}  // namespace poise::cut
