// What a solver hands back.
#pragma once

#include "problem/problem.h"
#include "problem/stop.h"

namespace poise {

struct Outcome {
  Placement placed;              // empty: none found
  double objective = kInfinity;  // its F
  double bound = -kInfinity;     // no placement has a lower F
  bool proven = false;           // nothing is better; nothing exists when none was found
  Reason reason = Reason::kDone;
  std::int64_t steps = 0;
};

}  // namespace poise
