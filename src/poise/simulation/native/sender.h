// The sending end of a connector: a route to one target, and a buffer during a move.
#pragma once

#include <cstdint>
#include <deque>
#include <unordered_map>

#include "links.h"
#include "model.h"

namespace poise::simulation {

class Container;

// What a component sends over one slot, whichever target that leads to.
class Sender {
 public:
  Sender(Container& container, const Connector& connector)
      : container_(container), connector_(&connector) {}

  const Connector& connector() const { return *connector_; }
  bool is_buffering() const { return is_buffering_; }
  // How many went out, and how many found no room in the buffer.
  std::uint64_t calls() const { return calls_; }
  std::uint64_t messages() const { return messages_; }
  std::uint64_t drops() const { return drops_; }

  // Send a message, or buffer it.
  void publish(Executor& source);
  // Call the target; the source goes on when it has answered, or its limit has passed;
  // with number 0 at once.
  void call(Executor& source, std::uint64_t number);
  // Send the marker of a migration behind all messages.
  void mark(std::uint64_t migration) { send({Item::Kind::marker, migration}); }
  // Send no message until `redirect`.
  void buffer() { is_buffering_ = true; }
  // Send to a target from now on, first of all what was buffered.
  void redirect(const Connector& connector);
  // Let go of all routes.
  void close();

 private:
  Stamps stamps(Executor& source) const;
  void put(Item item);
  void drop();
  void send(Item item);
  Stream& route(int here, int there);

  Container& container_;
  const Connector* connector_;
  bool is_buffering_ = false;
  std::uint64_t calls_ = 0, messages_ = 0, drops_ = 0;
  std::unordered_map<int, Stream*> routes_;
  std::deque<Item> buffer_;
};

}  // namespace poise::simulation
