// Links between computers: delays, cuts and clogs of each direction.
#pragma once

#include <deque>
#include <map>
#include <utility>
#include <vector>

#include "draws.h"
#include "events.h"

namespace poise::simulation {

// How a link behaves while nothing is wrong with it: one way and its jitter, the mean of
// what comes on top exponentially [s], and its bandwidth [bytes/s].
struct LinkModel {
  double latency, jitter, bandwidth;
};

class Links;
class Stream;

// One direction of a link; within a computer where both ends are the same.
struct Way {
  int source, target;
  LinkModel model;
  double free_at = 0.0, clogged_until = 0.0;
  std::deque<double> cuts{};  // when each began
  std::vector<Stream*> streams{};
};

// One direction of a connection: in order, none lost, until it is closed. What is sent
// over a cut link waits for its end, as TCP lets it.
class Stream {
 public:
  Stream(Links& links, Way& way) : links_(links), way_(way) {}
  Stream(const Stream&) = delete;
  Stream& operator=(const Stream&) = delete;

  // Deliver after all that was sent before.
  void send(double size, Action deliver);
  // Deliver nothing more.
  void close();
  bool is_closed() const { return is_closed_; }
  bool is_cut() const { return !way_.cuts.empty(); }
  Events& events() const;

 private:
  friend class Links;
  void send_held();

  Links& links_;
  Way& way_;
  bool is_closed_ = false;
  double last_ = 0.0;
  std::deque<std::pair<double, Action>> held_;
};

// The links between all computers, which are numbers here.
class Links {
 public:
  Links(Events& events, Draws& draws, Random jitter) : events_(events), draws_(draws), jitter_(jitter) {}

  // How a direction behaves; `usual`: each that has no model of its own.
  void set(int source, int target, LinkModel model) { way(source, target).model = model; }
  void set_usual(LinkModel usual) { usual_ = usual; }

  bool is_cut(int source, int target) { return !way(source, target).cuts.empty(); }
  // Let nothing through in one direction; each cut is healed by itself.
  void cut(int source, int target);
  // End the oldest cut; when it was the last one, streams go on.
  void heal(int source, int target);
  // Let what is sent from now on arrive after `seconds` at the soonest.
  void clog(int source, int target, double seconds);
  // When something that is sent now arrives [s], without a cut.
  double arrival(int source, int target, double size) { return arrival(way(source, target), size); }
  // How long so much takes over an idle link [s].
  double time_for(int source, int target, double size);
  Stream& stream(int source, int target);
  // Forget what waits for the end of a cut.
  void clear();

 private:
  friend class Stream;
  Way& way(int source, int target);
  double arrival(Way& way, double size);

  Events& events_;
  Draws& draws_;
  Random jitter_;
  LinkModel usual_{};
  std::map<std::pair<int, int>, Way> ways_;
  std::deque<Stream> streams_;
};

}  // namespace poise::simulation
