#include "shift.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace poise {

// A window counts for at most this much more than the largest that was learned from.
constexpr double outlier = 1.5;
constexpr std::size_t most_kept = 150;
// With so many windows the noise that was learned is still doubled; with more, less.
constexpr double sure = 30.0;

static double variance_of_blocks(const std::vector<double>& noise, std::size_t size) {
  double squares = 0.0;
  std::size_t num = 0;
  for (std::size_t start = 0; start + size <= noise.size(); start += size, ++num) {
    double sum = 0.0;
    for (std::size_t i = start; i < start + size; ++i) sum += noise[i];
    squares += sum * sum;
  }
  return squares / static_cast<double>(num * size);
}

// The variance per window that sums over many windows show. From blocks: where windows
// that follow each other are alike it is larger than that of single windows, where a
// burst is followed by a pause it is smaller.
static double variance(const std::vector<double>& noise) {
  return std::max(variance_of_blocks(noise, 5), variance_of_blocks(noise, 10));
}

// The highest that the sums would have come in `noise` itself.
static double swing(const std::vector<double>& noise, double slack) {
  double up = 0.0, down = 0.0, highest = 0.0;
  for (const double each : noise) {
    up = std::max(0.0, up + each - slack);
    down = std::max(0.0, down - each - slack);
    highest = std::max({highest, up, down});
  }
  return highest;
}

int Shift::update(double value, double exposure) {
  if (num_ < most_kept)
    windows_.push_back({value, exposure});
  else
    windows_[num_ % most_kept] = {value, exposure};
  ++num_;
  if (num_ >= learn_at_ && is_calm()) {
    fit();
    // Later it knows much: one more window tells little.
    learn_at_ = num_ + (num_ < most_kept ? learn : most_kept);
  }
  if (!reference_ || std::isinf(threshold_)) return 0;
  const double excess = value - *reference_ * exposure;
  return add(std::max(-largest_, std::min(largest_, excess)));
}

int Shift::add(double excess) {
  const double slack_here = slack * step_;
  up_ = std::max(0.0, up_ + excess - slack_here);
  down_ = std::max(0.0, down_ - excess - slack_here);
  if (std::max(up_, down_) <= threshold_) return 0;
  const int direction = up_ > down_ ? 1 : -1;
  up_ = down_ = 0.0;
  return direction;
}

// Whether no shift is in the making, which would pass for noise.
bool Shift::is_calm() const { return std::max(up_, down_) < threshold_ / 4; }

// Fit step and threshold to the windows that are kept.
void Shift::fit() {
  const double rate = typical_rate();
  if (rate <= 0.0) return;
  if (!is_given_ && num_ <= most_kept) reference_ = rate;
  std::vector<double> noise;
  noise.reserve(windows_.size());
  double exposure = 0.0, largest = 0.0;
  for (std::size_t i = 0; i < windows_.size(); ++i) {
    const Window& window = kept(i);
    noise.push_back(window.value - rate * window.exposure);
    exposure += window.exposure;
    largest = std::max(largest, std::abs(noise.back()));
  }
  const auto num = static_cast<double>(noise.size());
  step_ = *reference_ * exposure / num;
  largest_ = outlier * std::max(step_, largest);
  double fresh = variance(noise) * (1 + sure / num);
  // One calm stretch does not make a noisy component a calm one.
  if (num_ > most_kept) fresh = std::max(fresh, (fresh + variance_) / 2);
  variance_ = fresh;
  threshold_ = std::max({quickest * step_, fresh * rarity / (2 * slack * step_),
                         2 * swing(noise, slack * step_)});
}

// The median of the rates of five stretches: one outlier does not count.
double Shift::typical_rate() const {
  std::array<double, 5> rates{};
  const std::size_t size = windows_.size() / rates.size();
  for (std::size_t k = 0; k < rates.size(); ++k) {
    double value = 0.0, exposure = 0.0;
    for (std::size_t i = k * size; i < (k + 1) * size; ++i) {
      value += kept(i).value;
      exposure += kept(i).exposure;
    }
    rates[k] = exposure > 0.0 ? value / exposure : 0.0;
  }
  std::sort(rates.begin(), rates.end());
  return rates[2];
}

}  // namespace poise
