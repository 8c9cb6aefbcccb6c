// A call between components of one container, as fast as Python can be called.
#pragma once

#include <nanobind/nanobind.h>

#include <algorithm>
#include <cmath>

#include "exclusion.h"
#include "counters/histogram.h"
#include "counters/stats_page.h"

namespace poise {

// What one end of a connector counts; the delays of its calls are its own.
struct Counts {
  Slot entered;
  Histogram delay;    // of calls [s]
  Histogram wait;     // of messages [s]
  Histogram size;     // of what went over a wire, calls both ways [bytes]
  Histogram latency;  // of what came over a wire [s]

  ConnectorTotals& totals() { return entered->totals; }

  void add_call(double seconds, std::uint64_t out, std::uint64_t in, double under_way,
                double error, bool failed) {
    totals().calls.add(1);
    totals().errors.add(failed);
    delay.add(seconds);
    add_crossing(out, in, under_way, error);
  }
  void add_message(std::uint64_t out, std::uint64_t in, double under_way, double error) {
    totals().messages.add(1);
    add_crossing(out, in, under_way, error);
  }

 private:
  // `under_way` is no number when nobody knows how long what came was so.
  void add_crossing(std::uint64_t out, std::uint64_t in, double under_way, double error) {
    if (out + in == 0) return;
    totals().bytes_out.add(out);
    totals().bytes_in.add(in);
    size.add(static_cast<double>(out + in));
    if (!std::isfinite(under_way + error)) return;
    latency.add(under_way);
    totals().arrivals.add(1);
    totals().latency.add(nanoseconds(under_way));
    totals().latency_error.add(nanoseconds(error));
  }
  static std::uint64_t nanoseconds(double seconds) {
    return static_cast<std::uint64_t>(1e9 * std::clamp(seconds, 0.0, 1e9));
  }
};

// Return a function that calls `method` on the caller's thread, under `exclusion`, and counts it.
// `limit` is of the wait to enter and of the whole call [s]; less in a call of which less is left.
// The function raises Timeout when the component was busy, or the result came later than that;
// the callee itself is not interrupted. When the component has moved, it calls `resend` with the
// same arguments and counts nothing, or raises Redirected without one.
nanobind::object direct_call(nanobind::object method, nanobind::handle_t<Exclusion> exclusion,
                             double limit, nanobind::handle_t<Counts> counts,
                             nanobind::object translate, nanobind::object resend);

// Add the type that it needs to the module.
void bind_direct_call(nanobind::module_& module);

// Let `translate` raise what a caller gets instead of an error of its callee; KeyboardInterrupt goes
// on as it is.
void translate_error(nanobind::handle translate);

// Set the Python error that stands for an entry that failed. `action` says, with the
// limit, what was waited for.
void set_entry_error(const std::string& what, Entry entry, double limit, const char* action);

}  // namespace poise
