// A process that runs components: one interpreter, which uses one core at most.
#pragma once

#include <deque>
#include <limits>
#include <list>
#include <unordered_map>
#include <vector>

#include "cpu.h"
#include "model.h"
#include "sender.h"

namespace poise::simulation {

struct Engine;

class Container {
 public:
  // `on_progress` and `on_missed` are notices: see `await_progress` and `await_missed`.
  Container(Engine& engine, Cpu& cpu, int computer, Action on_progress, Action on_missed);
  Container(const Container&) = delete;
  Container& operator=(const Container&) = delete;

  Engine& engine() const { return engine_; }
  CpuGroup& group() const { return group_; }
  int computer() const { return computer_; }
  bool is_dead() const { return is_dead_; }
  // When it began, or its last pause ended [s].
  double awake_since() const { return awake_since_; }

  // Stand still, or go on: first of all with what came meanwhile.
  void pause(bool is_paused);
  // Do nothing more.
  void end();
  // Let leased components work until a moment [s].
  void set_lease_end(double end) { lease_end_ = end; }
  bool may_work(bool is_leased) const;

  // Run a component. All that was returned stays until the engine ends.
  Executor& add(ComponentKey key, Incarnation& who, const Model& model, DataAges ages);
  void remove(Executor& executor);
  Executor* find(ComponentKey key) const;
  // Whether any incarnation of a component is here, but for one.
  bool has(int component, const Executor* other_than) const;
  // Know the connectors of a deployment from now on; no others.
  void connect(const std::vector<const Connector*>& connectors);
  // Have or close a sending end.
  Sender& add_sender(const Connector& connector);
  void remove_sender(Sender& sender);
  Sender* sender_of(const Slot& slot, int epoch) const;
  std::vector<Sender*> senders_of(ComponentKey key) const;

  // Take what arrived over a connector.
  void receive(Item item);
  // Do something at once, or when it is not paused any more; nothing when it is dead.
  template <class Act>
  void perform(Act act) {
    if (is_paused_)
      late_.emplace_back(std::move(act));
    else if (!is_dead_)
      act();
  }

  // Leave a notice at the next turn that ends or item that comes.
  void await_progress() { awaits_progress_ = true; }
  void note_progress();
  // Leave a notice at the next release that misses its deadline.
  void await_missed() { awaits_missed_ = true; }
  void note_missed();

 private:
  Engine& engine_;
  CpuGroup& group_;
  int computer_;
  Action on_progress_, on_missed_;
  bool is_paused_ = false, is_dead_ = false;
  bool awaits_progress_ = false, awaits_missed_ = true;
  double awake_since_;
  double lease_end_ = std::numeric_limits<double>::infinity();
  std::vector<Action> late_;
  std::vector<Executor*> executors_;
  std::vector<Sender*> senders_;
  std::list<Executor> all_executors_;
  std::deque<Sender> all_senders_;
  std::unordered_map<int, const Connector*> connectors_;  // by the numbers of their keys
};

}  // namespace poise::simulation
