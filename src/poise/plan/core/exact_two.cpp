#include "exact_two.h"

#include <algorithm>
#include <cmath>

namespace poise {

TwoTree::TwoTree(const Problem& problem) : OrderedTree(problem) {
  if (!possible_) return;
  const double far = p_.far(0, 1);
  twins_ = twin_[1] == 0;
  variance_ = p_.variance;
  tie_start_.assign(1, 0);
  base_.assign(n_ + 1, 0.0);
  first_pull_.resize(n_);
  double cost = 0;
  for (int d = 0; d < n_; ++d) {
    const double at0 = p_.linear(order_[d], 0), at1 = p_.linear(order_[d], 1);
    first_pull_[d] = at1 - at0;
    cost += (at0 + at1) / 2;
  }
  for (int d = 0; d < n_; ++d) {
    base_[d] = cost;
    for (const Neighbour& other : p_.neighbours(order_[d])) {
      if (depth_of_[other.unit] <= d) continue;
      ties_.push_back({depth_of_[other.unit], other.overhead * far});
      cost += other.overhead * far / 2;
    }
    tie_start_.push_back(ties_.size());
    for (int k = 0; k < r_; ++k) {
      needs_.push_back({need_[d * r_ + k], open_[(d + 1) * r_ + k]});
    }
    forced_ += p_.choices(order_[d]) == 1;
  }
  base_[n_] = cost;
  for (int k = 0; k < r_; ++k) {
    Resource out{};
    for (int side = 0; side < 2; ++side) {
      out.left[side] = p_.capacity[k * 2 + side];
      out.floor[side] = p_.floor[k * 2 + side];
      out.scale[side] = p_.scale[k * 2 + side];
    }
    out.weight = p_.weight[k];
    first_resources_.push_back(out);
  }
  saved_pull_.resize(ties_.size());
}

void TwoTree::descend() {
  resources_ = first_resources_;
  pull_ = first_pull_;
  followed_ = pulling_ = 0;
  for (const double pull : pull_) pulling_ += std::fabs(pull);
  for (int d = 0; d < forced_; ++d) {
    const int side = p_.allowed(order_[d], 0) ? 0 : 1;
    if (!fits(d, side)) return;
    place(d, side);
  }
  open(forced_);
}

void TwoTree::open(int depth) {
  if (depth == n_) return found();
  stop_->after(1);
  double bounds[2];
  for (const int side : {0, 1}) bounds[side] = bound(depth, side);
  // The computers are alike until the first unit is on one of them.
  if (depth == 0 && twins_) bounds[1] = kInfinity;
  const int better = bounds[1] < bounds[0] ? 1 : 0;
  for (const int side : {better, 1 - better}) {
    if (bounds[side] >= threshold_) return;
    if (stop_->stopped()) {
      open_bound_ = std::min(open_bound_, bounds[side]);
      return;
    }
    enter(depth, side);
  }
}

void TwoTree::enter(int depth, int side) {
  const double followed = followed_, pulling = pulling_;
  place(depth, side);
  // The least that must be paid, with the new pulls; the balance was looked at before.
  if (base_[depth + 1] - (followed_ + pulling_) / 2 < threshold_) open(depth + 1);
  unplace(depth, side);
  followed_ = followed;
  pulling_ = pulling;
}

double TwoTree::bound(int depth, int side) const {
  const double pull = pull_[depth], size = std::fabs(pull);
  const double follows = side == 0 ? pull : -pull;
  const double pays = base_[depth] - (followed_ + follows + pulling_ - size) / 2;
  return fits(depth, side) ? pays + imbalance(depth, side) : kInfinity;
}

// The least spread if all that is open may still go where more is left.
double TwoTree::imbalance(int depth, int side) const {
  double total = 0;
  const Need* need = needs_.data() + static_cast<std::size_t>(depth) * r_;
  for (int k = 0; k < r_; ++k) {
    const Resource& resource = resources_[k];
    const double less = need[k].need * resource.scale[side];
    const double more = resource.left[0] * resource.scale[0] -
                        resource.left[1] * resource.scale[1] + (side == 0 ? -less : less);
    const double range = std::max(more - need[k].open * resource.scale[0],
                                  -more - need[k].open * resource.scale[1]);
    const double least = std::max(range, 0.0);
    total += resource.weight * (variance_ ? least * least / 4 : least);
  }
  return total;
}

bool TwoTree::fits(int depth, int side) const {
  const Need* need = needs_.data() + static_cast<std::size_t>(depth) * r_;
  bool all = true;
  for (int k = 0; k < r_; ++k) {
    all &= resources_[k].left[side] - need[k].need >= resources_[k].floor[side];
  }
  return all;
}

void TwoTree::place(int depth, int side) {
  const double x = side == 0 ? 1.0 : -1.0;
  at_[depth] = side;
  followed_ += x * pull_[depth];
  pulling_ -= std::fabs(pull_[depth]);
  const Need* need = needs_.data() + static_cast<std::size_t>(depth) * r_;
  for (int k = 0; k < r_; ++k) resources_[k].left[side] -= need[k].need;
  for (std::size_t e = tie_start_[depth]; e < tie_start_[depth + 1]; ++e) {
    double& pull = pull_[ties_[e].depth];
    saved_pull_[e] = pull;
    pulling_ -= std::fabs(pull);
    pull += x * ties_[e].overhead;
    pulling_ += std::fabs(pull);
  }
}

void TwoTree::unplace(int depth, int side) {
  const Need* need = needs_.data() + static_cast<std::size_t>(depth) * r_;
  for (int k = 0; k < r_; ++k) resources_[k].left[side] += need[k].need;
  for (std::size_t e = tie_start_[depth]; e < tie_start_[depth + 1]; ++e) {
    pull_[ties_[e].depth] = saved_pull_[e];
  }
}

}  // namespace poise
