// What components really did, by a common clock: what the invariants look at.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

namespace poise::simulation {

struct Incarnation;

// A component, over all its incarnations.
struct Life {
  Incarnation* current = nullptr;  // who worked last
  double since = 0.0;              // since when [s]
  int committed = 0;               // the epoch of the last move that was committed
};

// One life of a component in one process.
struct Incarnation {
  std::string component;
  int epoch;
  std::string computer;
  Life& life;
  bool is_past = false;  // a newer one has worked
  bool is_dead = false;  // its process has ended
};

// What a component sends over, whichever target it leads to: messages sent, the last that
// was processed, and those since then that were dropped.
struct Slot {
  // The messages from `first` to `last` that one component has processed.
  struct Run {
    const Life* reader;
    std::uint64_t first, last;
  };

  std::string name;
  std::uint64_t sent = 0, last = 0, dropped = 0;
  std::vector<Run> runs = {};  // a new one wherever another component goes on
};

class Ledger {
 public:
  // A handler that runs while its lease ends may go on this long beside a newer
  // incarnation, without any effect [s]: its container is killed then.
  static constexpr double late_handler = 0.75;

  Incarnation& incarnation(const std::string& component, int epoch,
                           const std::string& computer, std::int64_t process);
  Slot& slot(const std::string& name);

  // Note that a handler begins, ends or publishes; `awake`: since when its process runs
  // without a pause [s].
  void begin(Incarnation& who, double now);
  void end(const Incarnation& who, double awake, double now);
  void act(const Incarnation& who, double now);
  // Note that a client was told that a move to an incarnation is committed.
  void commit(const std::string& component, int epoch) { lives_[component].committed = epoch; }
  // Note that a message makes room for newer ones, or ends with its target.
  void drop(Slot& slot) { ++slot.dropped, ++dropped; }
  // Note that a message is processed.
  void process(Slot& slot, std::uint64_t number, const Incarnation& who);
  // Note what must never be.
  void violate(std::string invariant, std::string what) {
    violations_.emplace_back(std::move(invariant), std::move(what));
  }

  // Nothing is broken: no message may be lost.
  bool is_whole = false;
  // (invariant, sentence) in the order in which it was seen
  const std::vector<std::pair<std::string, std::string>>& violations() const {
    return violations_;
  }

  // Handlers and messages so far, messages that were dropped, calls that were answered, and
  // those that were not within their limits.
  std::uint64_t handled = 0, processed = 0, dropped = 0, calls = 0, failed_calls = 0;

 private:
  std::map<std::string, Life> lives_;
  std::map<std::tuple<std::string, int, std::int64_t>, Incarnation> incarnations_;
  std::map<std::string, Slot> slots_;
  std::vector<std::pair<std::string, std::string>> violations_;
};

}  // namespace poise::simulation
