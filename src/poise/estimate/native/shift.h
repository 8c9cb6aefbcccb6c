// Finds that a rate has shifted: poise/estimate/shift.py says how, and
// tests/estimate/reference.py is the same in Python.
#pragma once

#include <cstddef>
#include <limits>
#include <optional>
#include <vector>

namespace poise {

class Shift {
 public:
  // Shifts by less than this share of the reference are no shifts.
  static constexpr double slack = 0.25;
  static constexpr double rarity = 20.0;
  // Windows from which the noise is learned, and the reference when none is given.
  static constexpr std::size_t learn = 25;
  // [windows' worth of the reference] The threshold is never lower.
  static constexpr double quickest = 2.0;
  // What is over within so many windows is no shift; a shift has lasted twice as long.
  static constexpr std::size_t disturbance = 5;
  // [windows' worth of the reference] So much must be left without a disturbance.
  static constexpr double left = 1.0;

  explicit Shift(std::optional<double> reference)
      : reference_(reference), is_given_(reference.has_value()) {}

  // Take a window; 1 or -1 when the rate has shifted up or down.
  int update(double value, double exposure);

  std::optional<double> reference() const { return reference_; }
  // How many windows ago the shift began that was told last.
  std::size_t since() const { return since_; }

 private:
  struct Window {
    double value;
    double exposure;
  };

  // What exceeds the reference and the slack in one direction, since it last was nothing.
  struct Sum {
    double direction;
    double value = 0.0;
    std::size_t windows = 0;
  };

  bool add(Sum& sum, const Window& window);
  bool stands(const Sum& sum) const;
  double excess(const Sum& sum, const Window& window) const;
  bool is_calm() const;
  void fit();
  double typical_rate() const;

  // The windows that are kept, oldest first.
  const Window& kept(std::size_t index) const {
    return windows_[(num_ + index) % windows_.size()];
  }

  std::vector<Window> windows_;  // the last ones; later ones take the oldest's place
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
