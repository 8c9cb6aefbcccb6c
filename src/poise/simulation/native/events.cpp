#include "events.h"

#include <algorithm>
#include <limits>
#include <string>

namespace poise::simulation {

// So many events without any time passing are a loop that never ends.
constexpr std::uint64_t most_at_once = 1'000'000;

void Events::at(double moment, Action action) {
  heap_.push_back({std::max(moment, now_), ++number_, std::move(action)});
  std::push_heap(heap_.begin(), heap_.end());
}

double Events::next() const {
  return heap_.empty() ? std::numeric_limits<double>::infinity() : heap_.front().at;
}

double Events::run(double limit) {
  while (notices_.empty() && !heap_.empty() && heap_.front().at <= limit) {
    std::pop_heap(heap_.begin(), heap_.end());
    const Event event = std::move(heap_.back());
    heap_.pop_back();
    num_at_once_ = event.at > now_ ? 0 : num_at_once_ + 1;
    if (num_at_once_ > most_at_once)
      throw NoTimePasses("at " + std::to_string(now_) +
                         " s components go on without any time passing");
    now_ = event.at;
    event.action();
  }
  if (notices_.empty()) now_ = std::max(now_, limit);
  return now_;
}

bool Events::notify() {
  std::vector<Action> notices;
  notices.swap(notices_);
  for (const Action& notice : notices) notice();
  return !notices.empty();
}

void Events::clear() {
  heap_.clear();
  notices_.clear();
}

}  // namespace poise::simulation
