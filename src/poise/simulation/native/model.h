// What components do and how they are joined: what does not change while they work.
#pragma once

#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "data_ages.h"
#include "ledger.h"

namespace poise::simulation {

class Executor;

// What a handler sends over a slot: so much in each run on average.
struct Output {
  Slot* slot;
  double rate;
  double credit = 0.5;  // fractions add up over the runs
};

// What one run of a handler costs and does, as poise.simulation.component_models says.
struct Handler {
  double work, spread;
  double waiting, wait, wait_spread;  // how many wait for what is no CPU; the median [s]
  std::optional<std::vector<Output>> publishes;  // none: one message over each connector
  // It waits for each call; for those that it starts at once; for none.
  std::vector<Output> calls, joined, started;
};

struct TimerModel {
  std::string name;
  double period;
  std::optional<double> deadline;
  Handler handler;
};

// Where messages wait: one of the slots that lead there, and how many wait at most.
struct Port {
  const Slot* first;
  std::size_t room;
};

// What a component does.
struct Model {
  std::vector<TimerModel> timers;
  std::unordered_map<Slot*, Handler> takes, serves;  // messages and calls over a slot
  Handler other;                                     // and over all others
  std::optional<Handler> answer;  // of a started call: what takes it in a turn of its own
  std::vector<double> factors;  // how much dearer handlers are in each second
  std::unordered_map<const Slot*, Port> keep;  // those that say how many wait
  std::size_t keep_other;                // over each other slot
  double release_offset;  // when its timers are due [s], or periods before or after
};

// An incarnation of a component: the number of its name, and its epoch.
struct ComponentKey {
  int component, epoch;
  bool operator==(const ComponentKey& other) const {
    return component == other.component && epoch == other.epoch;
  }
};

// A connector of a deployment. Numbers stand for names.
struct Connector {
  std::string name, key;
  int name_number, key_number;
  Slot* slot;
  ComponentKey source, target;
  int target_computer;
  bool is_direct;
  double limit;  // of a call [s]
  double size;   // of a message, or of a call both ways [bytes]
  double source_cost, target_cost;  // beyond a local message's [core-seconds]
  std::vector<ChainId> carries, answers;
  mutable Executor* known = nullptr;  // the target that was found last
};

// The way of an answer: to the executor whose call has this number, 0: one that was
// started. `back`: over this connection; none: it is in the same container.
class Stream;
struct Call {
  Executor* caller;
  std::uint64_t number;
  Stream* back = nullptr;
  double size = 0.0;
};

// What goes over a connector: a message, a call, or the marker of a migration. `number` is
// a message's or a migration's. An answer to a started call waits for its turn.
struct Item {
  enum class Kind { message, call, marker, answer };

  Kind kind;
  std::uint64_t number = 0;
  Stamps stamps{};
  Call call{};
  const Connector* connector = nullptr;  // over which it came
};

}  // namespace poise::simulation
