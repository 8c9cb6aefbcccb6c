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

// The largest, but for those that follow each other and are the farthest off together.
static double largest_undisturbed(const std::vector<double>& noise) {
  constexpr std::size_t size = Shift::disturbance;
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

int Shift::update(double value, double exposure) {
  const Window window{value, exposure};
  if (num_ < most_kept)
    windows_.push_back(window);
  else
    windows_[num_ % most_kept] = window;
  ++num_;
  if (num_ >= learn_at_ && is_calm()) {
    fit();
    // Later it knows much: one more window tells little.
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

// What a window adds to a sum: no more than the noise that was learned lets expect.
double Shift::excess(const Sum& sum, const Window& window) const {
  const double raw = window.value - *reference_ * window.exposure;
  return sum.direction * std::clamp(raw, -largest_, largest_) - slack * step_;
}

// Add a window; whether the rate has shifted that way.
bool Shift::add(Sum& sum, const Window& window) {
  sum.value = std::max(0.0, sum.value + excess(sum, window));
  sum.windows = sum.value > 0.0 ? sum.windows + 1 : 0;
  return sum.value > threshold_ && stands(sum);
}

// Whether enough is left without the worst windows that follow each other.
bool Shift::stands(const Sum& sum) const {
  if (sum.windows < 2 * disturbance) return false;
  const std::size_t end = windows_.size(), begin = end - std::min(sum.windows, end);
  double part = 0.0, worst = -std::numeric_limits<double>::infinity();
  for (std::size_t i = begin; i < end; ++i) {
    part += excess(sum, kept(i));
    if (i >= begin + disturbance) part -= excess(sum, kept(i - disturbance));
    if (i + 1 >= begin + disturbance) worst = std::max(worst, part);
  }
  return sum.value - worst > left * step_;
}

// Whether no shift is in the making, which would pass for noise.
bool Shift::is_calm() const {
  return std::max(up_.value, down_.value) < threshold_ / 4;
}

// Fit step and threshold to the windows that are kept.
void Shift::fit() {
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
  largest_ = outlier * std::max(step_, largest_undisturbed(noise));
  for (double& each : noise) each = std::clamp(each, -largest_, largest_);
  double fresh = variance(noise) * (1 + sure / static_cast<double>(noise.size()));
  // One calm stretch does not make a noisy component a calm one.
  if (num_ > most_kept) fresh = std::max(fresh, (fresh + variance_) / 2);
  variance_ = fresh;
  threshold_ = std::max(quickest * step_, fresh * rarity / (2 * slack * step_));
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
