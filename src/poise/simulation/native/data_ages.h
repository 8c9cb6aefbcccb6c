// How old data is when a component of a chain uses it, as poise.runtime.execution.data_age
// has it: the rule stands there.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "histogram.h"

namespace poise::simulation {

// A chain, by the number of its name.
using ChainId = int;
// When the data of each chain that goes over a connector was made [s]; no number: unknown.
using Stamps = std::vector<double>;

// What one component knows of the data of one chain. `deadline` is how old it may be at
// the last component [s]; none elsewhere.
struct ChainAge {
  ChainId chain;
  bool is_first;
  std::optional<double> deadline;
  double held = std::numeric_limits<double>::quiet_NaN();  // [s]
  bool is_new = false;
  Histogram ages{};
  std::uint64_t missed = 0;

  void take(double stamp);
  void use(double now);
};

// The chains that one component is part of; all moments are arguments [s].
class DataAges {
 public:
  using Held = std::vector<std::pair<ChainId, double>>;

  void add(ChainId chain, bool is_first, std::optional<double> deadline) {
    chains_.push_back({chain, is_first, deadline});
  }
  const std::vector<ChainAge>& all() const { return chains_; }

  // Let a run begin, which has taken no data yet.
  void begin();
  // Let a run end: the last component of a chain has used its data; `is_later`: that may
  // have come before, as for a timer or the turn of an answer.
  void end(bool is_later, double now);
  // Take stamps that came with a message, a call or an answer.
  void take(const std::vector<ChainId>& chains, const Stamps& stamps);
  // The stamps of data that goes out now.
  Stamps stamps(const std::vector<ChainId>& chains, double now);
  // The stamps that a successor goes on with.
  Held held() const;
  void restore(const Held& held);

 private:
  ChainAge* find(ChainId chain);

  std::vector<ChainAge> chains_;
};

}  // namespace poise::simulation
