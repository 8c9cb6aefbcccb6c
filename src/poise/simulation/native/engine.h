// What happens often in a simulated robot: CPUs, links, and all that components do.
//
// Nothing here knows Python, or runs code of the outside: it is told by notices. All
// objects stay until the engine ends.
#pragma once

#include <deque>
#include <map>
#include <string>
#include <unordered_map>
#include <vector>

#include "container.h"
#include "cpu.h"
#include "draws.h"
#include "events.h"
#include "executor.h"
#include "ledger.h"
#include "links.h"
#include "model.h"
#include "sender.h"

namespace poise::simulation {

struct Engine {
  // `recorded` are the first draws of an earlier run.
  Engine(std::uint64_t seed, std::vector<double> recorded)
      : draws(seed, std::move(recorded)), links(events, draws, Random(~seed)) {}
  Engine(const Engine&) = delete;
  Engine& operator=(const Engine&) = delete;

  // The number that stands for a name, and back.
  int number(const std::string& name);
  const std::string& name(int number) const { return names_[static_cast<std::size_t>(number)]; }
  // The target of a connector, where it runs; null: nowhere.
  Executor* find(const Connector& connector);
  // Whether any incarnation of a component runs, but for one.
  bool runs(int component, const Executor* other_than = nullptr) const;
  // The connection over which answers go from one computer to another.
  Stream& back(int source, int target);
  // Let nothing more happen.
  void end();

  Events events;
  Draws draws;
  Links links;
  Ledger ledger;
  std::deque<Cpu> cpus;
  std::deque<Model> models;
  std::deque<Connector> connectors;
  std::deque<Container> containers;

 private:
  std::unordered_map<std::string, int> numbers_;
  std::vector<std::string> names_;
  std::map<std::pair<int, int>, Stream*> back_;
};

}  // namespace poise::simulation
