// Many values in little space: counts in buckets that grow by a fixed factor.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <memory>

namespace poise {

// Quantiles are right within 5 %, and within the range of the values; mean and maximum are
// exact. An octave takes memory only when a value fell into it.
class Histogram {
 public:
  static constexpr int per_octave = 8;
  static constexpr int lowest = -30;  // as powers of two
  static constexpr int highest = 64;

  // Count one value; below zero counts as zero, and so does what is no number.
  void add(double value);

  std::uint64_t count() const { return count_; }
  double mean() const { return count_ ? sum_ / static_cast<double>(count_) : 0.0; }
  double sum() const { return sum_; }
  double maximum() const { return maximum_; }

  // The value below which `share` of the values lie.
  double quantile(double share) const;

 private:
  using Octave = std::array<std::uint64_t, per_octave>;

  std::array<std::unique_ptr<Octave>, highest - lowest + 1> octaves_;
  std::uint64_t count_ = 0;
  double sum_ = 0.0;
  double minimum_ = std::numeric_limits<double>::infinity();
  double maximum_ = 0.0;
};

}  // namespace poise
