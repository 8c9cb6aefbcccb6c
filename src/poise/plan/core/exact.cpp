#include "exact.h"

#include <algorithm>

#include "exact_frontier.h"
#include "exact_tree.h"

namespace poise {
namespace {

// The tree for M computers: knowing their number, the compiler unrolls every loop over
// them, which makes small problems twice as fast. M = 0 takes any number.
template <int M>
class TreeOf final : public OrderedTree {
 public:
  using OrderedTree::OrderedTree;

 private:
  int m() const { return M > 0 ? M : m_; }

  void descend() override {
    start();
    open(0);
  }

  void open(int depth) {
    if (depth == n_) return found();
    Branch* branch = branch_.data() + static_cast<std::size_t>(depth) * m();
    const int count = branches(depth, branch);
    stop_->after(1);
    for (int i = 0; i < count; ++i) {
      if (branch[i].bound >= threshold_) return;
      if (stop_->stopped()) {
        open_bound_ = std::min(open_bound_, branch[i].bound);
        return;
      }
      if (enter(depth, branch[i].computer)) open(depth + 1);
      leave(depth, branch[i].computer);
    }
  }

  // The computers worth trying, most promising first.
  int branches(int depth, Branch* out) const {
    int count = 0;
    const double rest = paid_ + least_sum_ - least_[depth];
    const double* unary = unary_.data() + static_cast<std::size_t>(depth) * m();
    for (int h = 0; h < m(); ++h) {
      double bound = rest + unary[h];
      if (bound >= threshold_ || !fits(depth, h)) continue;
      for (int k = 0; k < r_ && bound < threshold_; ++k) {
        if (p_.weight[k] > 0) bound += p_.weight[k] * imbalance(depth, k, h);
      }
      if (bound >= threshold_) continue;
      int i = count++;
      for (; i > 0 && out[i - 1].bound > bound; --i) out[i] = out[i - 1];
      out[i] = {h, bound};
    }
    return count;
  }

  bool fits(int depth, int h) const {
    if (units_on_[h] == 0 && twin_[h] >= 0 && units_on_[twin_[h]] == 0) return false;
    const double* need = need_.data() + static_cast<std::size_t>(depth) * r_;
    for (int k = 0; k < r_; ++k) {
      if (left_[k * m() + h] - need[k] < p_.floor[k * m() + h]) return false;
    }
    return !p_.has_apart() || apart_fits(depth, h);
  }

  // The least spread of a resource when the unit at `depth` goes to `computer` and what
  // is open flows freely: it flows where most is left. Then no computer has more than
  // `level`, and the smallest residue cannot rise.
  double imbalance(int depth, int k, int computer) const {
    const double* scale = p_.scale.data() + static_cast<std::size_t>(k) * m();
    const double* size = size_.data() + static_cast<std::size_t>(k) * m();
    const double open = open_[(depth + 1) * r_ + k];
    double share[M > 0 ? M : Exact::kMostComputers];
    double low = kInfinity;
    for (int h = 0; h < m(); ++h) {
      share[h] = left_[k * m() + h] * scale[h];
      if (h == computer) share[h] -= need_[depth * r_ + k] * scale[h];
      if (scale[h] > 0 && share[h] < low) low = share[h];
    }
    // Begin level on all computers, leave out those that have less, and level again.
    double level = final_[k] / width_[k];
    for (;;) {
      double left = -open, width = 0;
      for (int h = 0; h < m(); ++h) {
        const bool above = share[h] >= level;
        left += above ? share[h] * size[h] : 0.0;
        width += above ? size[h] : 0.0;
      }
      const double next = width > 0 ? left / width : level;
      if (!(next > level + 1e-12)) break;
      level = next;
    }
    const double range = level - low;
    if (range <= 0) return 0;
    if (!p_.variance) return range;
    if (!alike_[k]) return range * range / (2.0 * m());
    double sum = 0, squares = 0;
    for (int h = 0; h < m(); ++h) {
      const double off = std::min(share[h], level) - level;
      sum += off;
      squares += off * off;
    }
    return (squares - sum * sum / m()) / m();
  }

  // Place the unit at `depth`; false when it cannot become better than the best.
  bool enter(int depth, int computer) {
    at_[depth] = computer;
    ++units_on_[computer];
    paid_ += unary_[depth * m() + computer];
    least_sum_ -= least_[depth];
    const double* need = need_.data() + static_cast<std::size_t>(depth) * r_;
    for (int k = 0; k < r_; ++k) left_[k * m() + computer] -= need[k];
    double* saved = saved_.data() + later_start_[depth] * (m() + 1);
    for (auto e = later_start_[depth]; e < later_start_[depth + 1]; ++e) {
      const int d = later_[e].depth;
      const double* pair = costs_.pair.data() + later_[e].table + computer * m();
      double* row = unary_.data() + static_cast<std::size_t>(d) * m();
      double least = kInfinity;
      for (int h = 0; h < m(); ++h) {
        saved[h] = row[h];
        row[h] += pair[h];
        least = row[h] < least ? row[h] : least;
      }
      saved[m()] = least_[d];
      saved += m() + 1;
      least_sum_ += least - least_[d];
      least_[d] = least;
    }
    const bool holds = p_.bandwidth.empty() || send(depth, computer, 1.0);
    return holds && paid_ + least_sum_ < threshold_;
  }

  void leave(int depth, int computer) {
    if (!p_.bandwidth.empty()) send(depth, computer, -1.0);
    const double* saved = saved_.data() + later_start_[depth] * (m() + 1);
    for (auto e = later_start_[depth]; e < later_start_[depth + 1]; ++e) {
      const int d = later_[e].depth;
      double* row = unary_.data() + static_cast<std::size_t>(d) * m();
      for (int h = 0; h < m(); ++h) row[h] = saved[h];
      least_sum_ += saved[m()] - least_[d];
      least_[d] = saved[m()];
      saved += m() + 1;
    }
    const double* need = need_.data() + static_cast<std::size_t>(depth) * r_;
    for (int k = 0; k < r_; ++k) left_[k * m() + computer] += need[k];
    least_sum_ += least_[depth];
    paid_ -= unary_[depth * m() + computer];
    --units_on_[computer];
  }
};

std::unique_ptr<Exact::Tree> tree_for(const Problem& problem) {
  if (FrontierTree::takes(problem)) {
    auto tree = std::make_unique<FrontierTree>(problem);
    if (tree->narrow()) return tree;
  }
  switch (problem.m) {
    case 2: return std::make_unique<TreeOf<2>>(problem);
    case 3: return std::make_unique<TreeOf<3>>(problem);
    case 4: return std::make_unique<TreeOf<4>>(problem);
    default: return std::make_unique<TreeOf<0>>(problem);
  }
}

}  // namespace

Exact::Exact(const Problem& problem) : tree_(tree_for(problem)) {}
Exact::~Exact() = default;

Outcome Exact::run(const Placement& known, Stop& stop) { return tree_->run(known, stop); }

}  // namespace poise
