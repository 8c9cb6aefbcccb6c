// The threads that a component's code has started, or a library that it uses.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "kernel_counters.h"

namespace poise {

// A thread has the name of the one that started it until it gets one of its own, as all of
// Poise's do. So those with the name of a component's thread are that component's; where
// two components' threads have one name, they are nobody's.
class OwnThreads {
 public:
  // `proc` is where the kernel's process files are.
  OwnThreads(const std::string& proc, int process)
      : proc_(proc), tasks_(proc + "/" + std::to_string(process) + "/task"), main_(process) {}

  // Look up who is there now, which takes 10 us for each thread. `components`: the threads
  // of the process's components.
  void look(const std::vector<int>& components);

  // The CPU time of those of a component's thread [ns], also of those that have ended; it is
  // forgotten with that thread.
  std::int64_t cpu(int component);

 private:
  struct Owned {
    std::map<int, std::unique_ptr<ThreadCounters>> threads;
    std::int64_t ended = 0;  // [ns]
  };

  std::string proc_;
  std::string tasks_;
  int main_;
  std::map<int, Owned> owned_;  // by the component's thread
};

}  // namespace poise
