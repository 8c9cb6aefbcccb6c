// The agent's end of a ledger: what a container used and did, at any moment.
#pragma once

#include <nanobind/nanobind.h>

#include <memory>
#include <string>
#include <vector>

#include "kernel_counters.h"
#include "ledger.h"

namespace poise {

class Reader {
 public:
  Reader(int descriptor, int process, std::string proc)
      : pages_(descriptor, false), process_(process), proc_(std::move(proc)) {}

  // (at, cpu, components, connectors), as `ContainerSample` has them; None when nothing
  // is entered, or the process has ended.
  nanobind::object read();

  // The processes whose memory is the container's besides its own.
  std::vector<int> commands() const;

 private:
  struct Known {  // of a line, as long as its number stays
    std::uint64_t id = 0;
    nanobind::object name;
    std::unique_ptr<ThreadCounters> thread;
    double called = 0.0;       // what calls add to its thread's CPU time [s]
    std::uint64_t served = 0;  // calls
    std::uint64_t asked = 0;   // by timers
  };

  void learn();
  void attribute(double now);
  Known* component(std::uint64_t id);
  nanobind::tuple component_sample(std::size_t index, double& of_commands);
  nanobind::tuple connector_sample(std::size_t index) const;

  Pages pages_;
  int process_;
  std::string proc_;
  std::vector<Known> known_;
};

}  // namespace poise
