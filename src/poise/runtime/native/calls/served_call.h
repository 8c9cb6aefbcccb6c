// Answers the calls of one method from other containers, on the thread that received each.
//
// It runs the method under the exclusion and counts its CPU time. A call chain runs on one thread
// of a process at a time: a call back enters when the chain's first thread waits in `call_remote`.
#pragma once

#include <nanobind/nanobind.h>

#include "deadline.h"
#include "direct_call.h"
#include "exclusion.h"
#include "counters/lease_end.h"

namespace poise {

class ServedCall {
 public:
  ServedCall(nanobind::object decode, nanobind::object method, nanobind::object encode,
             nanobind::object exclusion, double limit, nanobind::object counts,
             nanobind::object translate, nanobind::object is_over, nanobind::object lease);

  // The pieces of the answer to a call's frame. `ahead` is how far the caller's clock is ahead at
  // most [s]; no number: nobody knows, and the time on the wire does not count. Raises
  //   Timeout     the caller's limit has passed, another thread ran the chain or another chain was
  //               inside all the time, or the caller is gone: the method was not called
  //   Redirected  the component has moved away: the method was not called
  //   LeaseEnded  the component's lease has ended: the method was not called
  //   WireError   what `decode` raised
  nanobind::object answer(nanobind::handle frame, double ahead);

 private:
  Moment deadline_of(nanobind::handle frame, double ahead, Moment began) const;
  void refuse_late(Moment until, Moment now) const;
  void refuse_fenced() const;
  [[noreturn]] void refuse(const nanobind::object& why) const;
  nanobind::object run(nanobind::handle values);
  [[noreturn]] void raise_callee_error();

  nanobind::object decode_;  // body and buffers to the arguments
  nanobind::object method_;
  nanobind::object encode_;  // the result to pieces
  nanobind::object exclusion_, counts_;
  nanobind::object translate_;  // as DirectCall's
  nanobind::object is_over_;    // whether the caller is gone
  nanobind::object lease_;      // None: the component is not leased
  Exclusion& exclusion_of_;     // inside `exclusion_`
  Counts& counts_of_;           // inside `counts_`
  const LeaseEnd* lease_of_;    // inside `lease_`
  double limit_;                // [s]
};

// Return what `request(pieces, limit)` does; meanwhile the chain may be called back.
// `what` is the connector of the call, for errors.
nanobind::object call_remote(Chain chain, double limit, const char* what,
                             nanobind::handle request, nanobind::handle pieces);

}  // namespace poise
