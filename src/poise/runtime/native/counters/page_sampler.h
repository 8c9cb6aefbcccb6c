// The agent's end of a stats page: what a container used and did, at any moment.
#pragma once

#include <nanobind/nanobind.h>

#include <memory>
#include <string>
#include <vector>

#include "kernel_counters.h"
#include "stats_page.h"

namespace poise {

class PageSampler {
 public:
  PageSampler(int descriptor, int process, std::string proc)
      : memory_(descriptor, false), process_(process), proc_(std::move(proc)) {}

  // (at, cpu, components, connectors), as `ContainerSample` has them; None when nothing
  // is entered, or the process has ended.
  nanobind::object read();

  // How often the container's control thread has run.
  std::uint64_t heartbeat() const { return memory_.heartbeat(); }

  // The processes whose memory is the container's besides its own.
  std::vector<int> commands() const;

 private:
  struct Known {  // of a record, as long as its id stays
    std::uint64_t id = 0;
    nanobind::object name;
    bool has_name = true;  // it is reported
    std::unique_ptr<ThreadCounters> thread;  // of a component, or a call that runs
    std::uint64_t call = 0;    // that runs over it
    std::int64_t began = 0;    // the CPU time of that one's thread when it was first seen [ns]
    double called = 0.0;       // what calls add to its thread's CPU time [s]
    std::uint64_t served = 0;  // calls
    std::uint64_t asked = 0;   // by timers
  };

  void learn();
  void attribute(double now);
  double called_over(std::size_t index);
  double running_over(std::size_t index);
  Known* component(std::uint64_t id);
  nanobind::tuple component_sample(std::size_t index, double& of_commands);
  nanobind::tuple connector_sample(std::size_t index) const;

  StatsMemory memory_;
  int process_;
  std::string proc_;
  std::vector<Known> known_;
};

}  // namespace poise
