// What a run draws, for a replay.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "random.h"

namespace poise::simulation {

// A number in [0, 1).
inline double uniform(Random& random) {
  return static_cast<double>(random.next() >> 11) * 0x1p-53;
}

// Numbers in [0, 1) from a seed. The first are those of an earlier run where there are any.
class Draws {
 public:
  Draws(std::uint64_t seed, std::vector<double> recorded)
      : seed_(seed), random_(seed), recorded_(std::move(recorded)) {}

  double next() {
    const double drawn = uniform(random_);
    return num_ < recorded_.size() ? recorded_[num_++] : (++num_, drawn);
  }

  // All draws so far. They are drawn again, for nobody needs them while all goes well.
  std::vector<double> made() const {
    Draws again(seed_, recorded_);
    std::vector<double> found;
    found.reserve(num_);
    while (found.size() < num_) found.push_back(again.next());
    return found;
  }

 private:
  std::uint64_t seed_;
  Random random_;
  std::vector<double> recorded_;
  std::size_t num_ = 0;
};

}  // namespace poise::simulation
