// Virtual time: what happens at which moment, and what the outside is to be told of.
#pragma once

#include <cstdint>
#include <functional>
#include <stdexcept>
#include <vector>

namespace poise::simulation {

using Action = std::function<void()>;

struct NoTimePasses : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// All moments are virtual [s]; the run begins at 0.
class Events {
 public:
  double now() const { return now_; }

  // Let something happen at a moment, or at once when that is past. What has one moment
  // happens in the order of these calls.
  void at(double moment, Action action);

  // The moment of the next event; infinite: there is none.
  double next() const;

  // Let events happen until `limit`, or until one of them has left a notice. Return the
  // present moment. Throws NoTimePasses when events loop.
  double run(double limit);

  // Leave a notice. It is called when no event happens, as it may run code that changes
  // anything.
  void tell(Action notice) { notices_.push_back(std::move(notice)); }

  // Call what was left; return whether there was anything.
  bool notify();

  // Let nothing more happen.
  void clear();

 private:
  struct Event {
    double at;
    std::uint64_t number;
    Action action;
    // whether it happens later
    bool operator<(const Event& other) const {
      return at > other.at || (at == other.at && number > other.number);
    }
  };

  double now_ = 0.0;
  std::uint64_t number_ = 0;
  std::uint64_t num_at_once_ = 0;
  std::vector<Event> heap_;
  std::vector<Action> notices_;
};

}  // namespace poise::simulation
