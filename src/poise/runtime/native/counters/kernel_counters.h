// What the kernel counts of threads and processes.
#pragma once

#include <cstdint>
#include <ctime>
#include <string>

namespace poise {

// The kernel's numbers for CPU clocks (CPUCLOCK_SCHED): of a thread, for its own process
// alone; of a process, for everybody.
inline clockid_t thread_cpu_clock(int thread) { return ~thread * 8 | 4 | 2; }
inline clockid_t process_cpu_clock(int process) { return ~process * 8 | 2; }

// Read a CPU clock [ns]; false when its thread or process has ended.
bool read_cpu(clockid_t clock, std::int64_t& used);

// The counters of one thread of any process, kept open where possible.
class ThreadCounters {
 public:
  // `proc` is where the kernel's process files are.
  ThreadCounters(const std::string& proc, int thread);
  ~ThreadCounters();
  ThreadCounters(const ThreadCounters&) = delete;
  ThreadCounters& operator=(const ThreadCounters&) = delete;

  int thread() const { return thread_; }

  // False when the thread has ended. Up to one tick of the kernel old (1 to 10 ms) when
  // the thread runs right now.
  bool read();

  std::int64_t cpu = 0;   // [ns]
  std::int64_t wait = 0;  // it could run and did not [ns]; 0 where nobody counts that

 private:
  bool parse(const char* text);

  int thread_;
  int descriptor_;
  bool has_wait_ = true;
};

}  // namespace poise
