// A call between components of one container, as fast as Python can be called.
#pragma once

#include <nanobind/nanobind.h>

#include "cpu_share.h"
#include "histogram.h"

namespace poise {

// What one end of a connector counts.
struct Counts {
  std::uint64_t calls = 0;
  std::uint64_t messages = 0;
  std::uint64_t bytes_out = 0;  // that left this end over a wire
  std::uint64_t bytes_in = 0;   // that came to this end over a wire
  std::uint64_t errors = 0;
  std::uint64_t drops = 0;
  Histogram delay;  // of calls [s]
  Histogram wait;   // of messages [s]
  CpuShare cpu;     // of the callee's code, and of what it called

  void add_call(double seconds, std::uint64_t out, std::uint64_t in, bool failed) {
    ++calls;
    errors += failed;
    bytes_out += out;
    bytes_in += in;
    delay.add(seconds);
  }
  void add_message(std::uint64_t out, std::uint64_t in) {
    ++messages;
    bytes_out += out;
    bytes_in += in;
  }
};

// The type `DirectCall`: a callable with the vectorcall protocol.
nanobind::object make_direct_call_type();

// Set the Python error that stands for an entry that failed. `action` says, with the
// limit, what was waited for.
void set_entry_error(const std::string& what, int entry, double limit,
                     const char* action);

}  // namespace poise
