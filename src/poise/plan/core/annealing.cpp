// Cooling: simulated annealing over connected pieces of the component graph.
#include <algorithm>
#include <array>
#include <cmath>

#include "search.h"

namespace poise {
namespace {

constexpr int kLogs = 1024;
constexpr std::size_t kLargestPiece = 64;
// The last temperature, in mean changes of F; 0.002 to 0.01 do about as well.
constexpr double kCold = 0.005;
// With what probability (of 256) a piece grows along a connector; 0 is a single unit.
constexpr int kKeep[8] = {0, 0, 0, 0, 0, 128, 200, 256};

// -log of the middle of each of 1,024 steps of (0, 1).
const std::array<double, kLogs>& minus_logs() {
  static const std::array<double, kLogs> table = [] {
    std::array<double, kLogs> out{};
    for (int i = 0; i < kLogs; ++i) out[i] = -std::log((i + 0.5) / kLogs);
    return out;
  }();
  return table;
}

}  // namespace

// True with probability `keep` / 256; a random word serves eight times.
bool Search::follow(int keep) {
  if (dice_left_ == 0) {
    dice_ = random_.next();
    dice_left_ = 8;
  }
  --dice_left_;
  const int byte = static_cast<int>(dice_ & 255);
  dice_ >>= 8;
  return byte < keep;
}

// Gather the piece around `seed` on its computer that may go to `to`.
void Search::grow(int seed, int to, int keep, Units& piece) {
  const int here = state_.at(seed);
  piece.push_back(seed);
  seen_[seed] = ++piece_;
  if (keep <= 0) return;
  for (std::size_t i = 0; i < piece.size() && piece.size() < kLargestPiece; ++i) {
    for (const Neighbour& other : p_.neighbours(piece[i])) {
      if (seen_[other.unit] == piece_ || state_.at(other.unit) != here) continue;
      if (!follow(keep) || !p_.allowed(other.unit, to)) continue;
      seen_[other.unit] = piece_;
      piece.push_back(other.unit);
    }
  }
}

// Make up a search move; false when it is not allowed.
bool Search::propose() {
  auto& [out, back, a, b] = move_;
  out.clear();
  back.clear();
  const int unit = movable_[random_.below(static_cast<int>(movable_.size()))];
  const std::uint64_t dice = random_.next();
  const auto neighbours = p_.neighbours(unit);
  a = b = state_.at(unit);
  if ((dice & 1) != 0 && neighbours.size() > 0) {
    // Towards what it is connected to.
    const int i = random_.below(static_cast<int>(neighbours.size()));
    b = state_.at(neighbours.first[i].unit);
  }
  if (b == a) {
    b = random_.below(p_.m - 1);
    b += b >= a;
  }
  if (!p_.allowed(unit, b)) return false;
  const int keep = kKeep[(dice >> 1) & 7];
  grow(unit, b, keep, out);
  const Units& there = state_.on(b);
  if (((dice >> 4) & 1) == 0 || there.empty()) return true;
  const int other = there[random_.below(static_cast<int>(there.size()))];
  if (!p_.allowed(other, a)) return false;
  grow(other, a, ((dice >> 5) & 1) != 0 ? keep : 0, back);
  return true;
}

// Find by how much F changes with a search move, and what breaking a limit should cost.
void Search::calibrate() {
  double sum = 0;
  int count = 0;
  for (int i = 0; i < 200; ++i) {
    if (!propose()) continue;
    const auto& [out, back, a, b] = move_;
    const Change weighed = state_.weigh(out, back, a, b);
    const double change = std::fabs(aimless_ ? weighed.excess : weighed.objective);
    sum += change;
    count += change > 0;
  }
  unit_ = count > 0 ? sum / count : 1.0;
  double share = 0;  // of a mean limit, that a mean unit asks for
  for (int k = 0; k < p_.r; ++k) {
    double demand = 0;
    for (int i = 0; i < p_.n; ++i) demand += p_.need(i)[k];
    const double limit = p_.mean_room(k);
    if (limit > 0) share = std::max(share, demand / p_.n / limit);
  }
  lowest_price_ = share > 0 ? 0.3 * unit_ / share : unit_;
  price_ = std::max(price_, 3 * lowest_price_);
}

void Search::reprice() {
  if (state_.feasible()) price_ = std::max(lowest_price_, price_ * 0.95);
  else price_ = std::min(price_ * 1.1, 1e6 * lowest_price_);
}

void Search::note() {
  if (!state_.feasible() || state_.objective() >= record_ - 1e-12) return;
  record_ = state_.objective();
  noted_ = state_.placed();
}

// One cooling of `steps` search moves, from where the state is; `heat` is the first
// temperature, in mean changes of F.
void Search::cool(std::int64_t steps, double heat) {
  calibrate();
  record_ = best_objective_;
  noted_.clear();
  steps = std::max<std::int64_t>(steps, 256);
  const std::int64_t period = std::clamp<std::int64_t>(p_.n, 32, 4096);
  const double part = static_cast<double>(period) / static_cast<double>(steps);
  const double factor = std::pow(kCold / heat, part);
  double temperature = heat * unit_;
  for (std::int64_t step = 0; step < steps && !stop_.stopped(); step += period) {
    if (aimless_ && !noted_.empty()) break;
    for (std::int64_t i = 0; i < period; ++i) {
      if (propose()) try_move(temperature * minus_logs()[random_.next() >> 54]);
    }
    temperature *= factor;
    reprice();
    stop_.after(period);
  }
  if (!noted_.empty()) offer(noted_);
}

// Take the proposed move if it makes things worse by no more than `limit`.
void Search::try_move(double limit) {
  const auto& [out, back, a, b] = move_;
  const double paid = state_.weigh_paid(out, back, a, b);
  // At best, balance, shortage and excess fall to nothing; often that is not enough already.
  if (!aimless_ && paid - state_.loads() - price_ * state_.excess() > limit) return;
  const Change rest = state_.weigh_rest(out, back, a, b);
  const double change = aimless_ ? rest.excess : paid + rest.objective + price_ * rest.excess;
  if (change > limit) return;
  state_.apply(out, back, a, b);
  note();
}

}  // namespace poise
