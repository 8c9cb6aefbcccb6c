// The CPU time of a process and of all that it started.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

namespace poise {

// The kernel adds a process's CPU time to its parent's, in ticks, when the parent takes
// note of its end. So what living processes used is added to what ended ones did. Who is
// there is looked up once a second, and when one that was there has ended.
class ProcessTree {
 public:
  struct Process {
    int number;
    std::uint64_t started = 0;  // since the computer started [ticks]; 0: not known yet
    std::int64_t cpu = 0;       // its own [ns]
    std::int64_t ended = 0;     // of children of whose end it took note [ns]
    int starter = 0;            // the thread of the root that started it, or its ancestor
    bool is_child = false;      // of the root: the end of others is in their parents' time

    // Both return false when it has ended. `proc` is where the kernel's process files are.
    bool read_own();
    bool read_ended(const std::string& proc);
  };

  ProcessTree(std::string proc, int root) : proc_(std::move(proc)), root_{root} {}

  // Look up each time who is there, once there was a descendant: what ends within a second
  // counts when it is used, then. It takes 10 us for each thread.
  void look_closely() { is_close_ = true; }

  int root() const { return root_.number; }

  // The CPU time [ns], never less than before; false when the root has ended.
  bool read(std::int64_t& used);

  // The CPU time of those that a thread of the root started, also when they have ended [ns];
  // it is forgotten with that thread.
  std::int64_t started_by(int thread) const;

  // Those that were there when it was last read, also when their parent has ended.
  std::vector<int> descendants() const;

 private:
  void look();
  template <typename Condition>
  bool drop(Condition is_gone);
  void add_children_of(Process parent);
  void forget_ended_threads();
  std::int64_t never_less(std::int64_t total);

  std::string proc_;
  Process root_;
  std::vector<Process> descendants_;
  std::map<int, std::int64_t> ended_;  // starter -> what ended had used [ns]
  bool is_close_ = false;
  bool had_descendants_ = false;
  std::int64_t look_at_ = 0;  // [ns]
  std::int64_t lost_ = 0;     // of descendants of whose end nobody here took note [ns]
  std::int64_t last_ = 0;     // what was read last [ns]
};

}  // namespace poise
