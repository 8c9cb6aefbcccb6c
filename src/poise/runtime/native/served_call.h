// A call that came over a pipe, answered on the thread that brought it.
#pragma once

#include <nanobind/nanobind.h>

#include "direct_call.h"
#include "turn.h"

namespace poise {

class ServedCall {
 public:
  ServedCall(nanobind::object decode, nanobind::object method, nanobind::object encode,
             nanobind::object turn, double limit, nanobind::object counts,
             nanobind::object translate, nanobind::object is_over);

  // The pieces of the answer to a call's frame; raises what keeps it from one.
  nanobind::object answer(nanobind::handle frame);

 private:
  double limit_of(nanobind::handle frame) const;
  nanobind::object run(nanobind::handle values);
  [[noreturn]] void raise_callee_error();

  nanobind::object decode_;  // body and buffers to the arguments
  nanobind::object method_;
  nanobind::object encode_;  // the result to pieces
  nanobind::object turn_, counts_;
  nanobind::object translate_;  // as DirectCall's
  nanobind::object is_over_;    // whether the caller is gone
  Turn& turn_of_;               // inside `turn_`
  Counts& counts_of_;           // inside `counts_`
  double limit_;                // [s]
};

// Return what `request(pieces, limit)` does, and let the chain come back meanwhile.
// `what` is the connector of the call, for errors.
nanobind::object away(Chain chain, double limit, const char* what, nanobind::handle request,
                      nanobind::handle pieces);

}  // namespace poise
