#include "change_point.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace poise {

// A window counts for at most this multiple of the largest window learned from.
constexpr double clip = 1.5;
constexpr std::size_t most_kept = 150;
// The learned noise is doubled after this many windows, and raised less after more.
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

// The variance per window of sums over many windows. It comes from blocks: it is larger
// than the variance of single windows when neighbours are alike, and smaller when a pause
// follows a burst.
static double variance(const std::vector<double>& noise) {
  return std::max(variance_of_blocks(noise, 5), variance_of_blocks(noise, 10));
}

// The largest deviation outside the worst run of `outlier` consecutive windows.
static double largest_without_outlier(const std::vector<double>& noise) {
  constexpr std::size_t size = ChangePointDetector::outlier;
  std::size_t worst = 0;
  double farthest = -1.0;
  for (std::size_t begin = 0; begin + size <= noise.size(); ++begin) {
    double sum = 0.0;
    for (std::size_t i = begin; i < begin + size; ++i) sum += noise[i];
    if (std::abs(sum) <= farthest) continue;
    farthest = std::abs(sum);
    worst = begin;
  }
  double largest = 0.0;
  for (std::size_t i = 0; i < noise.size(); ++i)
    if (i < worst || i >= worst + size) largest = std::max(largest, std::abs(noise[i]));
  return largest;
}

int ChangePointDetector::update(double value, double exposure) {
  const Window window{value, exposure};
  if (num_ < most_kept)
    windows_.push_back(window);
  else
    windows_[num_ % most_kept] = window;
  ++num_;
  if (num_ >= learn_at_ && is_calm()) {
    fit();
    // Later one more window adds little knowledge.
    learn_at_ = num_ + (num_ < most_kept ? learn : most_kept);
  }
  if (!reference_ || std::isinf(threshold_)) return 0;
  const bool is_up = add(up_, window), is_down = add(down_, window);
  if (!is_up && !is_down) return 0;
  since_ = is_up ? up_.windows : down_.windows;
  up_ = Sum{1.0};
  down_ = Sum{-1.0};
  return is_up ? 1 : -1;
}

// What a window adds to a sum, clipped to the learned noise.
double ChangePointDetector::excess(const Sum& sum, const Window& window) const {
  const double raw = window.value - *reference_ * window.exposure;
  return sum.direction * std::clamp(raw, -largest_, largest_) - slack * step_;
}

// Add a window; return whether the rate has changed in this direction.
bool ChangePointDetector::add(Sum& sum, const Window& window) {
  sum.value = std::max(0.0, sum.value + excess(sum, window));
  sum.windows = sum.value > 0.0 ? sum.windows + 1 : 0;
  return sum.value > threshold_ && persists(sum);
}

// Whether the sum stays large enough without its worst `outlier` consecutive windows.
bool ChangePointDetector::persists(const Sum& sum) const {
  if (sum.windows < 2 * outlier) return false;
  const std::size_t end = windows_.size(), begin = end - std::min(sum.windows, end);
  double part = 0.0, worst = -std::numeric_limits<double>::infinity();
  for (std::size_t i = begin; i < end; ++i) {
    part += excess(sum, kept(i));
    if (i >= begin + outlier) part -= excess(sum, kept(i - outlier));
    if (i + 1 >= begin + outlier) worst = std::max(worst, part);
  }
  return sum.value - worst > left * step_;
}

// Whether no change is building up, which would be learned as noise.
bool ChangePointDetector::is_calm() const {
  return std::max(up_.value, down_.value) < threshold_ / 4;
}

// Fit step and threshold to the kept windows.
void ChangePointDetector::fit() {
  const double rate = typical_rate();
  if (rate <= 0.0) return;
  if (!is_given_ && num_ <= most_kept) reference_ = rate;
  std::vector<double> noise;
  noise.reserve(windows_.size());
  double exposure = 0.0;
  for (std::size_t i = 0; i < windows_.size(); ++i) {
    const Window& window = kept(i);
    noise.push_back(window.value - rate * window.exposure);
    exposure += window.exposure;
  }
  step_ = *reference_ * exposure / static_cast<double>(noise.size());
  largest_ = clip * std::max(step_, largest_without_outlier(noise));
  for (double& each : noise) each = std::clamp(each, -largest_, largest_);
  double fresh = variance(noise) * (1 + sure / static_cast<double>(noise.size()));
  // One calm stretch does not make a noisy component calm.
  if (num_ > most_kept) fresh = std::max(fresh, (fresh + variance_) / 2);
  variance_ = fresh;
  threshold_ = std::max(quickest * step_, fresh * rarity / (2 * slack * step_));
}

// The median of the rates of five stretches, so that one outlier does not count.
double ChangePointDetector::typical_rate() const {
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
