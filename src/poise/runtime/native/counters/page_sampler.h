// The agent's end of a stats page: what a container used and did, at any moment.
#pragma once

#include <nanobind/nanobind.h>

#include <memory>
#include <string>
#include <vector>

#include "kernel_counters.h"
#include "own_threads.h"
#include "process_tree.h"
#include "stats_page.h"

namespace poise {

class PageSampler {
 public:
  PageSampler(int descriptor, int process, std::string proc)
      : memory_(descriptor, false), proc_(std::move(proc)), tree_(proc_, process),
        own_threads_(proc_, process) {}

  // (at, cpu, components, connectors), as `ContainerSample` has them; None when nothing
  // is entered, or the process has ended.
  nanobind::object read();

  // How often the container's control thread has run.
  std::uint64_t heartbeat() const { return memory_.heartbeat(); }

  // The processes that are the container's besides its own: commands, and what these and
  // components started.
  std::vector<int> descendants() const { return tree_.descendants(); }

 private:
  struct Known {  // of a record, as long as its id stays
    std::uint64_t id = 0;
    nanobind::object name;
    bool has_name = true;  // it is reported
    std::unique_ptr<ThreadCounters> thread;  // of a component, or a call that runs
    std::unique_ptr<ProcessTree> command;    // of a component that is one
    std::uint64_t call = 0;    // that runs over it
    std::int64_t began = 0;    // the CPU time of that one's thread when it was first seen [ns]
    double called = 0.0;       // what calls add to its thread's CPU time [s]
    std::uint64_t served = 0;  // calls
    std::uint64_t asked = 0;   // by timers
    std::int64_t own = 0;  // the CPU time of threads and processes that it has started [ns]
  };

  void learn();
  void look_for_threads();
  void attribute(double now);
  double called_over(std::size_t index);
  double running_over(std::size_t index);
  Known* component(std::uint64_t id);
  nanobind::tuple component_sample(std::size_t index);
  void read_command(Known& known, int process, std::int64_t& used);
  nanobind::tuple connector_sample(std::size_t index) const;

  StatsMemory memory_;
  std::string proc_;
  ProcessTree tree_;
  OwnThreads own_threads_;
  std::vector<Known> known_;
  double read_at_ = 0.0, rest_ = 0.0;  // what was nobody's when it was last read [s]
  double looked_at_ = 0.0, looked_rest_ = 0.0;
};

}  // namespace poise
