// Detects changes of a rate: cumulative sums with a threshold that fits the noise.
//
// This is Page's CUSUM: deviations beyond a slack add up, and the sum never falls below
// zero. By Wald's approximation a sum of independent steps with variance s2 and drift -k
// passes h once in about exp(2 k h / s2) steps. So h = s2 * rarity / (2 k) makes
// false alarms equally rare for any noise. The more noise, the later a change is found.
//
// Changes by less than a quarter of the reference are ignored. rarity = 20 gives one false
// alarm in exp(20) windows, years at 5 Hz, if the noise is normal. The threshold is never
// lower than two windows' worth of the reference.
//
// Real noise is not normal. Steady components have single windows with 10 ms more CPU time
// than all others, and a machine may be slow for most of a second. So a change must last
// for ten windows, and must remain without its worst `outlier` consecutive windows: no
// deviation shorter than a second is a change. No window counts for more than one and a
// half times the largest learned one, one outlier excepted. A change by half is found
// after 10 windows at the earliest.
//
// Each component has three detectors, and each window passes through all of them;
// tests/estimate/reference.py does the same in Python.
#pragma once

#include <cstddef>
#include <limits>
#include <optional>
#include <vector>

namespace poise {

class ChangePointDetector {
 public:
  // Smaller changes, as a share of the reference, are ignored.
  static constexpr double slack = 0.25;
  static constexpr double rarity = 20.0;
  // Windows to learn the noise from, and the reference if none is given.
  static constexpr std::size_t learn = 25;
  // [windows' worth of the reference] The threshold is never lower.
  static constexpr double quickest = 2.0;
  // Deviations of up to this many windows are outliers; a change lasts twice as long.
  static constexpr std::size_t outlier = 5;
  // [windows' worth of the reference] What must remain without the outlier.
  static constexpr double left = 1.0;

  explicit ChangePointDetector(std::optional<double> reference)
      : reference_(reference), is_given_(reference.has_value()) {}

  // Add a window; return 1 or -1 when the rate has risen or fallen, else 0.
  int update(double value, double exposure);

  std::optional<double> reference() const { return reference_; }
  // How many windows ago the last change began.
  std::size_t since() const { return since_; }

 private:
  struct Window {
    double value;
    double exposure;
  };

  // The excess over reference and slack in one direction since it was last zero.
  struct Sum {
    double direction;
    double value = 0.0;
    std::size_t windows = 0;
  };

  bool add(Sum& sum, const Window& window);
  bool persists(const Sum& sum) const;
  double excess(const Sum& sum, const Window& window) const;
  bool is_calm() const;
  void fit();
  double typical_rate() const;

  // The kept windows, oldest first.
  const Window& kept(std::size_t index) const {
    return windows_[(num_ + index) % windows_.size()];
  }

  std::vector<Window> windows_;  // a ring buffer
  std::size_t num_ = 0;
  std::size_t learn_at_ = learn;
  std::optional<double> reference_;
  bool is_given_;
  Sum up_{1.0};
  Sum down_{-1.0};
  std::size_t since_ = 0;
  double threshold_ = std::numeric_limits<double>::infinity();
  double step_ = 0.0;
  double largest_ = 0.0;
  double variance_ = 0.0;
};

}  // namespace poise
