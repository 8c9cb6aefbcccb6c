// The stats page: shared memory in which a container counts and which its agent reads, so
// that neither wakes the other. Of all that is in it, the agent writes the lease's end alone. poise/runtime/execution/counters.py says what is in it.
//
// Each record has a sequence lock: its id is 0 while it is filled and different after
// every use, so a reader that sees the same id before and after has read one record.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "cpu_share.h"
#include "running_call.h"
#include "../shared_number.h"

namespace poise {

enum class Kind : std::uint32_t { none, component, timer, connector };

// What a component does, and whose CPU time is its own.
struct Jobs {
  Shared<std::uint64_t> asked;  // messages and one-way calls; timers are records
  Shared<std::uint64_t> done;
  Shared<std::int32_t> thread;      // 0: it has none any more
  Shared<std::uint16_t> is_process;  // whether all threads of that process count
  Shared<std::uint16_t> is_idle;     // whether the thread waits for work
  Shared<std::int64_t> cpu;          // when it last began to wait, or ended [ns]
};

// What goes over one end of a connector.
struct ConnectorTotals {
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
  RunningCall running;  // is not in `cpu` yet
};

// What is read often comes first, so that the rest stays out of the caches.
struct alignas(64) Record {
  Shared<std::uint64_t> id;  // 0: free, or being filled
  Shared<Kind> kind;
  Shared<std::uint32_t> epoch;
  Shared<std::uint64_t> target;  // a component's id, of a connector or timer; 0: not here
  Shared<std::uint64_t> source;  // as `target`, of a connector
  Jobs jobs;                     // of a component
  Shared<double> start;          // of a timer [s]
  Shared<double> period;         // of a timer [s]
  ConnectorTotals totals;        // of a connector
  SharedText<256> name;          // holds two components and their ports
};

// How many releases a timer's record has had at `now` [s].
std::uint64_t timer_releases(const Record& timer, double now);

// A mapping of the memory, which both ends have.
class StatsMemory {
 public:
  // Raises std::system_error when the descriptor cannot be mapped.
  StatsMemory(int descriptor, bool writable);
  ~StatsMemory();
  StatsMemory(const StatsMemory&) = delete;
  StatsMemory& operator=(const StatsMemory&) = delete;

  std::size_t size() const { return size_; }
  Record& operator[](std::size_t index) const { return records_[index]; }

  // The record with that id; none when it is gone.
  Record* find(std::uint64_t id) const;

  // Whether all that was read of a record before this call belongs to that id.
  bool is_still(std::size_t index, std::uint64_t id) const;

  // How often the container's control thread has run.
  std::uint64_t heartbeat() const;
  void beat();

  // When the lease of the container's components ends [s, CLOCK_BOOTTIME].
  double lease_end() const;
  void set_lease_end(double at);

  // One more than the index of the last record that was ever taken.
  std::size_t used() const;
  void set_used(std::size_t used);

 private:
  struct Head;

  Head* head_;
  Record* records_;
  std::size_t size_;
  std::size_t bytes_;
};

// The container's end: records are taken and given back.
class StatsPage {
 public:
  explicit StatsPage(int descriptor) : memory_(descriptor, true) {}

  void beat() { memory_.beat(); }

  // None when the page is full.
  Record* take();
  // Let the agent see a record that was filled; returns its id.
  std::uint64_t show(Record& record);
  void give_back(Record& record);

 private:
  StatsMemory memory_;
  std::vector<std::size_t> free_;
  std::size_t used_ = 0;
  std::uint64_t serial_ = 0;
};

// A record, whether it is in a stats page or not.
class Slot {
 public:
  Slot() = default;
  ~Slot() { leave(); }
  Slot(const Slot&) = delete;
  Slot& operator=(const Slot&) = delete;

  // Go on in the page, under that name; false when it is full.
  bool enter(std::shared_ptr<StatsPage> page, Kind kind, const std::string& name,
             std::uint32_t epoch);
  // Go on outside.
  void leave();

  std::uint64_t id() const { return record_->id.get(); }
  const std::shared_ptr<StatsPage>& page() const { return page_; }
  Record& operator*() const { return *record_; }
  Record* operator->() const { return record_; }

 private:
  std::shared_ptr<StatsPage> page_;
  Record own_{};
  Record* record_ = &own_;
};

}  // namespace poise
