// The least cut between two blocks near their common border, by maximal flow.
#pragma once

#include "../stop.h"
#include "graph.h"

namespace poise::cut {

// For every two blocks that touch, takes the nodes about their border and finds the least
// cut through them that leaves all else where it is; of several that cut as little, one
// that loads the two blocks evenly.
class Flow {
 public:
  Flow(Stop& stop, Random& random) : stop_(stop), random_(random) {}

  // Make `block` better for `limit`; returns by how much.
  std::int64_t run(const Graph& graph, const std::vector<double>& limit, Blocks& block);

 private:
  struct Arc {
    std::int32_t to, back, left;  // who, the arc the other way, what it can still carry
  };
  struct Touch {
    std::int32_t a, b, node;  // a < b: `node` is in one of them, and touches the other
  };

  bool find_touches();
  std::int64_t improve(std::size_t first, std::size_t last, double reach);
  bool gather(std::size_t first, std::size_t last, double reach);
  void connect();
  std::int64_t fill();
  bool level_nodes();
  std::int32_t augment(std::int32_t from);
  bool divide();
  void reach_from(std::int32_t node);

  Stop& stop_;
  Random& random_;
  const Graph* graph_ = nullptr;
  const std::vector<double>* limit_ = nullptr;
  Blocks* block_ = nullptr;
  std::vector<double> load_;
  std::vector<Touch> touches_;
  std::int32_t a_ = 0, b_ = 0;
  std::vector<std::int32_t> name_;   // node -> its number in the region, -1
  std::vector<std::int32_t> nodes_;  // the region
  std::vector<std::int32_t> start_, next_;  // each one's arcs; the next one to try
  std::vector<Arc> arcs_;
  std::vector<std::int32_t> source_, sink_;  // what can still come from a, go to b
  std::vector<std::int32_t> level_, path_, queue_;
  std::vector<char> at_a_;
  std::int64_t now_ = 0;  // what the region cuts now
};

}  // namespace poise::cut
