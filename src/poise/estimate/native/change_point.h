// Detects changes of a rate: poise/estimate/change_point.py explains the method, and
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
