// The ledger: the memory in which a container counts, and which its agent reads too, so
// that neither wakes the other. poise/runtime/ledger.py says what is entered.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "cpu_share.h"
#include "shared.h"

namespace poise {

enum class Kind : std::uint32_t { none, component, timer, connector };

// What a component does, and whose CPU time is its own.
struct Jobs {
  Shared<std::uint64_t> asked;  // messages and one-way calls; timers are lines
  Shared<std::uint64_t> done;
  Shared<std::int32_t> thread;      // 0: it has none any more
  Shared<std::uint16_t> is_process;  // whether all threads of that process count
  Shared<std::uint16_t> is_idle;     // whether the thread waits for work
  Shared<std::int64_t> cpu;          // when it last began to wait, or ended [ns]
};

// What goes over one end of a connector.
struct Tally {
  Shared<std::uint64_t> calls;
  Shared<std::uint64_t> messages;
  Shared<std::uint64_t> bytes_out;  // that left this end over a wire
  Shared<std::uint64_t> bytes_in;   // that came to this end over a wire
  Shared<std::uint64_t> errors;
  Shared<std::uint64_t> drops;
  Shared<std::uint64_t> arrivals;       // whose latency is known
  Shared<std::uint64_t> latency;        // of these, in all [ns]
  Shared<std::uint64_t> latency_error;  // of these, in all [ns]
  CpuShare cpu;  // of the callee's code, and of what it called
};

// What is read often comes first: whoever reads seldom finds nothing in the caches.
struct alignas(64) Line {
  static constexpr std::size_t longest_name = 255;  // two components and their ports

  Shared<std::uint64_t> id;  // 0: the line is free; written last, and cleared first
  Shared<Kind> kind;
  Shared<std::uint32_t> epoch;
  Shared<std::uint64_t> target;  // a component's id, of a connector or timer; 0: not here
  Shared<std::uint64_t> source;  // as `target`, of a connector
  Jobs jobs;                     // of a component
  Shared<double> start;          // of a timer [s]
  Shared<double> period;         // of a timer [s]
  Tally tally;                   // of a connector
  char name[longest_name + 1];
};

// How many releases a timer's line has had at `now` [s].
std::uint64_t timer_releases(const Line& timer, double now);

// A mapping of the memory, which both ends have.
class Pages {
 public:
  // Raises std::system_error when the descriptor cannot be mapped.
  Pages(int descriptor, bool writable);
  ~Pages();
  Pages(const Pages&) = delete;
  Pages& operator=(const Pages&) = delete;

  std::size_t size() const { return size_; }
  Line& operator[](std::size_t index) const { return lines_[index]; }

  // The line with that number; none when it is gone.
  Line* find(std::uint64_t id) const;

  // One more than the index of the last line that was ever taken.
  std::size_t used() const;
  void set_used(std::size_t used);

 private:
  struct Head;

  Head* head_;
  Line* lines_;
  std::size_t size_;
  std::size_t bytes_;
};

// The container's end: lines are taken and given back.
class Ledger {
 public:
  explicit Ledger(int descriptor) : pages_(descriptor, true) {}

  // None when the ledger is full.
  Line* take();
  // Let the agent see a line that was filled; returns its number.
  std::uint64_t show(Line& line);
  void give_back(Line& line);

 private:
  Pages pages_;
  std::vector<std::size_t> free_;
  std::size_t used_ = 0;
  std::uint64_t serial_ = 0;
};

// What is counted at one place, whether it stands in a ledger or not.
class Entered {
 public:
  Entered() = default;
  ~Entered() { leave(); }
  Entered(const Entered&) = delete;
  Entered& operator=(const Entered&) = delete;

  // Go on in the ledger, under that name; false when it is full.
  bool enter(std::shared_ptr<Ledger> ledger, Kind kind, const std::string& name,
             std::uint32_t epoch);
  // Go on outside.
  void leave();

  std::uint64_t id() const { return line_->id.get(); }
  const std::shared_ptr<Ledger>& ledger() const { return ledger_; }
  Line& operator*() const { return *line_; }
  Line* operator->() const { return line_; }

 private:
  std::shared_ptr<Ledger> ledger_;
  Line own_{};
  Line* line_ = &own_;
};

}  // namespace poise
