// A call between components of one container, as fast as Python can be called.
#pragma once

#include <nanobind/nanobind.h>

#include "histogram.h"
#include "ledger.h"

namespace poise {

// What one end of a connector counts; the delays of its calls are its own.
struct Counts {
  Entered entered;
  Histogram delay;  // of calls [s]
  Histogram wait;   // of messages [s]

  Tally& tally() { return entered->tally; }

  void add_call(double seconds, std::uint64_t out, std::uint64_t in, bool failed) {
    tally().calls.add(1);
    tally().errors.add(failed);
    tally().bytes_out.add(out);
    tally().bytes_in.add(in);
    delay.add(seconds);
  }
  void add_message(std::uint64_t out, std::uint64_t in) {
    tally().messages.add(1);
    tally().bytes_out.add(out);
    tally().bytes_in.add(in);
  }
};

// The type `DirectCall`: a callable with the vectorcall protocol.
nanobind::object make_direct_call_type();

// Set the Python error that stands for an entry that failed. `action` says, with the
// limit, what was waited for.
void set_entry_error(const std::string& what, int entry, double limit,
                     const char* action);

}  // namespace poise
