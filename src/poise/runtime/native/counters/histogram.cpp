#include "histogram.h"

#include <algorithm>
#include <cmath>

namespace poise {

// Bucket b holds the values in (2^((b - 1) / 8), 2^(b / 8)].
static int bucket_of(double value) {
  static const auto bounds = [] {
    std::array<double, Histogram::per_octave> found{};
    for (int i = 0; i < Histogram::per_octave; ++i)
      found[i] = std::exp2(static_cast<double>(i) / Histogram::per_octave);
    return found;
  }();
  int exponent = 0;
  const double mantissa = 2.0 * std::frexp(value, &exponent);  // in [1, 2)
  int above = 0;
  for (const double bound : bounds) above += mantissa > bound;
  return (exponent - 1) * Histogram::per_octave + above;
}

void Histogram::add(double value) {
  if (!(value > 0.0)) value = 0.0;
  const double inside =
      std::clamp(value, std::ldexp(1.0, lowest), std::ldexp(1.0, highest));
  const int index = bucket_of(inside) - lowest * per_octave;
  auto& octave = octaves_[index / per_octave];
  if (!octave) octave = std::make_unique<Octave>();
  ++(*octave)[index % per_octave];
  ++count_;
  sum_ += value;
  minimum_ = std::min(minimum_, value);
  maximum_ = std::max(maximum_, value);
}

double Histogram::quantile(double share) const {
  const double rank = share * static_cast<double>(count_);
  std::uint64_t seen = 0;
  for (std::size_t i = 0; i < octaves_.size(); ++i) {
    if (!octaves_[i]) continue;
    for (int j = 0; j < per_octave; ++j) {
      seen += (*octaves_[i])[j];
      if (seen == 0 || static_cast<double>(seen) < rank) continue;
      const double bucket = static_cast<double>(i * per_octave + j) + lowest * per_octave;
      return std::clamp(std::exp2((bucket - 0.5) / per_octave), minimum_, maximum_);
    }
  }
  return maximum_;
}

}  // namespace poise
