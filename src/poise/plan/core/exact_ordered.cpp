#include "exact_tree.h"

#include <algorithm>

#include "fluid.h"

namespace poise {
namespace {

// How much a component's weight in the balance counts, against its ties to placed ones,
// as the next to be placed. Found by trial: 0.3 to 1.6 are about as good.
constexpr double kSizeOverTie = 0.6;
constexpr int kPasses = 4;

}  // namespace

OrderedTree::OrderedTree(const Problem& problem) : Tree(problem) {
  if (!possible_) return;
  sort_units();
  connect();
  find_twins();
  price();
  measure();
}

// Units with one choice first, then always the one with the most to say: by ties to those
// before it, so that a costly cut is seen early, and by size, so that an imbalance is.
void OrderedTree::sort_units() {
  std::vector<double> value(n_, 0.0);
  for (int k = 0; k < r_; ++k) {
    double scale = 0;
    for (int h = 0; h < m_; ++h) scale += p_.scale[k * m_ + h] / m_;
    for (int i = 0; i < n_; ++i) {
      value[i] += kSizeOverTie * p_.weight[k] * p_.demand[i * r_ + k] * scale;
    }
  }
  order_.reserve(n_);
  depth_of_.resize(n_);
  const auto take = [&](int unit) {
    depth_of_[unit] = static_cast<std::int32_t>(order_.size());
    order_.push_back(unit);
    for (const Neighbour& other : p_.neighbours(unit)) value[other.unit] += other.overhead;
  };
  std::vector<std::int32_t> open;
  for (const std::int32_t unit : p_.order) {
    if (p_.choices(unit) == 1) take(unit);
    else open.push_back(unit);
  }
  while (!open.empty()) {
    const auto next = std::max_element(
        open.begin(), open.end(), [&](int a, int b) { return value[a] < value[b]; });
    take(*next);
    open.erase(next);
  }
}

void OrderedTree::connect() {
  later_start_.assign(n_ + 1, 0);
  for (int d = 0; d < n_; ++d) {
    for (const Neighbour& other : p_.neighbours(order_[d])) {
      const int depth = depth_of_[other.unit];
      if (depth <= d) continue;
      later_.push_back({depth, later_.size() * m_ * m_});
      costs_.edges.push_back({d, depth});
      for (int a = 0; a < m_; ++a) {
        for (int b = 0; b < m_; ++b) costs_.pair.push_back(other.overhead * p_.far(a, b));
      }
    }
    later_start_[d + 1] = later_.size();
  }
}

// Of computers that are alike and still empty, only the first need be tried.
void OrderedTree::find_twins() {
  twin_.assign(m_, -1);
  if (!p_.cost.empty() || !p_.distance.empty() || !p_.bandwidth.empty()) return;
  for (int h = 1; h < m_; ++h) {
    for (int g = h - 1; g >= 0 && twin_[h] < 0; --g) {
      bool same = true;
      for (int k = 0; k < r_ && same; ++k) {
        same = p_.capacity[k * m_ + h] == p_.capacity[k * m_ + g] &&
               p_.floor[k * m_ + h] == p_.floor[k * m_ + g];
      }
      for (int i = 0; i < n_ && same; ++i) same = p_.allowed(i, h) == p_.allowed(i, g);
      if (same) twin_[h] = g;
    }
  }
}

// Set up the costs of communication, shifted so that their bound is good.
void OrderedTree::price() {
  costs_.n = n_;
  costs_.m = m_;
  costs_.unary.resize(static_cast<std::size_t>(n_) * m_);
  for (int d = 0; d < n_; ++d) {
    for (int h = 0; h < m_; ++h) {
      const bool allowed = p_.allowed(order_[d], h);
      costs_.unary[d * m_ + h] = allowed ? p_.linear(order_[d], h) : kInfinity;
    }
  }
  // On two computers it costs more time than it saves.
  if (m_ > 2) costs_.shift(kPasses);
}

void OrderedTree::measure() {
  need_.resize(static_cast<std::size_t>(n_) * r_);
  open_.assign(static_cast<std::size_t>(n_ + 1) * r_, 0.0);
  for (int d = n_ - 1; d >= 0; --d) {
    for (int k = 0; k < r_; ++k) {
      need_[d * r_ + k] = p_.demand[order_[d] * r_ + k];
      open_[d * r_ + k] = open_[(d + 1) * r_ + k] + need_[d * r_ + k];
    }
  }
  alike_.resize(r_);
  width_.assign(r_, 0.0);
  final_.assign(r_, 0.0);
  size_.assign(static_cast<std::size_t>(r_) * m_, 0.0);
  for (int k = 0; k < r_; ++k) {
    alike_[k] = all_alike(p_, k);
    final_[k] = -open_[k];
    for (int h = 0; h < m_; ++h) {
      const double scale = p_.scale[k * m_ + h];
      if (scale <= 0) continue;
      size_[k * m_ + h] = 1 / scale;
      width_[k] += 1 / scale;
      final_[k] += p_.capacity[k * m_ + h];
    }
  }
  saved_.resize(later_.size() * static_cast<std::size_t>(m_ + 1));
  branch_.resize(static_cast<std::size_t>(n_ + 1) * m_);
}

void OrderedTree::start() {
  unary_ = costs_.unary;
  left_ = p_.capacity;
  units_on_.assign(m_, 0);
  traffic_.assign(p_.bandwidth.size(), 0.0);
  least_.resize(n_);
  paid_ = least_sum_ = 0;
  for (int d = 0; d < n_; ++d) {
    const double* row = unary_.data() + static_cast<std::size_t>(d) * m_;
    least_[d] = *std::min_element(row, row + m_);
    least_sum_ += least_[d];
  }
}

bool OrderedTree::apart_fits(int depth, int computer) const {
  for (const std::int32_t other : p_.apart(order_[depth])) {
    if (depth_of_[other] == depth) return false;
    if (depth_of_[other] < depth && at_[depth_of_[other]] == computer) return false;
  }
  return true;
}

// Add or take away the traffic of the unit at `depth` to those before it; whether all
// links hold it.
bool OrderedTree::send(int depth, int computer, double sign) {
  bool holds = true;
  for (const Neighbour& other : p_.neighbours(order_[depth])) {
    if (depth_of_[other.unit] >= depth) continue;
    const int there = at_[depth_of_[other.unit]];
    if (there == computer) continue;
    const std::size_t link = static_cast<std::size_t>(std::max(there, computer)) * m_ +
                             std::min(there, computer);
    traffic_[link] += sign * other.traffic;
    const double limit = p_.bandwidth[link];
    holds &= traffic_[link] <= limit + kSlack * std::max(1.0, limit);
  }
  return holds;
}

}  // namespace poise
