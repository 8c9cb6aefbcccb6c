// Runs the handlers of one incarnation of a component: its mailbox, its timers, its turns.
//
// A turn is one run of a handler: it takes its data, calls others and waits for their
// answers, works, and sends what comes of it. One turn runs at a time. The answer of a call
// that was only started is taken in another turn.
#pragma once

#include <deque>
#include <map>
#include <string>
#include <unordered_map>
#include <vector>

#include "container.h"
#include "data_ages.h"
#include "model.h"
#include "timers.h"

namespace poise::simulation {

// What moves beside the snapshot: what waits, timers' phases, ages of data.
struct ExecutorState {
  std::deque<Item> waiting;
  std::map<std::string, double> due;
  DataAges::Held held;
};

class Executor {
 public:
  Executor(Container& container, ComponentKey key, Incarnation& who, const Model& model,
           DataAges ages);
  Executor(const Executor&) = delete;
  Executor& operator=(const Executor&) = delete;

  const ComponentKey& key() const { return key_; }
  Container& container() const { return container_; }
  // Whether messages reach it.
  bool is_there() const { return !is_removed_ && !container_.is_dead(); }
  bool is_busy() const { return is_busy_; }
  // Whether it may begin a turn.
  bool is_working() const;

  // The component is active; it is not any more.
  void activate();
  void deactivate();
  // Whether it is to work while it is active.
  void set_wanted(bool is_wanted) { is_wanted_ = is_wanted; }
  bool is_wanted() const { return is_wanted_; }
  // Whether it has worked and is idle: what waits is lost with it, wherever another begins.
  void set_idle(bool is_idle) { is_idle_ = is_idle; }
  // Whether it works under a lease only.
  void set_leased(bool is_leased) { is_leased_ = is_leased; }
  // Begin no turn from now on; begin turns again.
  void pause();
  void resume();
  // Begin a turn, if a timer is due or something waits.
  void work();
  // Leave a notice once, when the turn ends that runs now.
  void when_idle(Action notice) { when_idle_ = std::move(notice); }

  // Take a message or a call; the oldest message of its port makes room.
  void take(Item item);
  // Drop what waits, unless it works and another incarnation runs: of a move nothing may be
  // lost.
  void drop_waiting();
  // Give away all that waits; have it back, before all that came since.
  ExecutorState hand_over();
  void take_back(const ExecutorState& state);
  // Go on from the state of another incarnation.
  void restore(const ExecutorState& state);

  // Note a marker that came; return the last one over a connector, 0: none came.
  void note_marker(const Connector& connector, std::uint64_t migration);
  std::uint64_t marker(int connector) const;
  // Whether a later incarnation of the source has sent, too: see
  // poise.runtime.connectors.endpoints.
  bool is_overtaken(const Connector& connector);
  void forget_source(const Connector& connector);

  // Go on, unless the call is over: with the stamps of the answer; none: it was late.
  void end_call(std::uint64_t number, const Connector& over, const Stamps* answer);

  Timers& timers() { return timers_; }
  DataAges& ages() { return ages_; }
  // Work of its turns so far [core-seconds].
  double cpu() const {
    container_.group().used();  // until now
    return cpu_;
  }
  // Messages, calls and releases that came, and that were ended.
  std::uint64_t asked() const { return asked_; }
  std::uint64_t done() const { return done_; }

 private:
  friend class Container;

  // What the turn that runs is about: `item`, or a release of `timer`.
  struct Turn {
    Handler* handler;
    Timer* timer;
    Item item;
    double release, began;
    std::vector<std::vector<Sender*>> to_call;  // those of one entry at once
  };

  double now() const;
  bool may_work() const { return container_.may_work(is_leased_); }
  Port port_of(const Slot* slot) const;
  // Drop the oldest message of a port, in whose turn the next one comes, and so on.
  // Return whether there was one.
  bool make_room(const Port& port, Item& item);
  // Look again when a timer is due.
  void plan();
  void on_due(double due);
  void begin_turn(Turn turn);
  void call_next();
  void begin_wait();
  void begin_work();
  void finish_work();
  void publish();
  void end_turn();
  // To whom it sends in this run.
  std::vector<Sender*> senders(std::vector<Output>& outputs);

  Container& container_;
  Engine& engine_;
  ComponentKey key_;
  Incarnation& who_;
  Model model_;
  Timers timers_;
  DataAges ages_;
  bool is_active_ = false, is_wanted_ = false, is_paused_ = false, is_leased_ = false;
  bool is_idle_ = false, is_removed_ = false;
  std::deque<Item> mailbox_;
  // Messages by their port; of these, those that came before its last pause ended, which
  // take no room.
  std::unordered_map<const Slot*, std::size_t> waiting_, while_paused_;
  std::unordered_map<int, std::uint64_t> markers_;
  std::unordered_map<int, int> latest_;  // connector -> the latest epoch that has sent
  bool is_busy_ = false;
  Turn turn_{};
  std::uint64_t call_ = 0;
  std::vector<std::uint64_t> open_;  // calls whose answers its turn waits for
  double due_at_;
  Action when_idle_;
  double cpu_ = 0.0;
  std::uint64_t asked_ = 0, done_ = 0;
  std::int64_t missed_ = 0;
};

}  // namespace poise::simulation
