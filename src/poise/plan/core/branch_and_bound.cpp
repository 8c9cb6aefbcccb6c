// Branch and bound on any number of computers. Its bound is what has been paid, plus the
// least that every open unit must pay towards placed ones, plus the imbalance that is left
// if open demand flowed freely, plus what is beyond time limits already.
#include <algorithm>
#include <memory>

#include "frontier.h"
#include "tree.h"
#include "relaxation.h"
#include "times.h"

namespace poise {
namespace {

// How much a component's weight in the balance counts, against its ties to placed ones,
// as the next to be placed. Found by trial: 0.3 to 1.6 are about as good.
constexpr double kSizeOverTie = 0.6;

class AnyTree final : public Tree {
 public:
  explicit AnyTree(const Problem& problem) : Tree(problem) {
    if (!possible_) return;
    sort_units();
    connect();
    find_twins();
    measure();
    if (p_.time_limits) times_.emplace(p_);
  }

 private:
  struct Later {  // a connector to a unit that is deeper in the tree
    int depth;
    double overhead;
  };
  struct Branch {
    int computer;
    double bound;
  };

  // Units with one choice first, then always the one with the most to say: by ties to
  // those before it, so that a costly cut is seen early, and by size, so that an
  // imbalance is.
  void sort_units() {
    std::vector<double> value(n_, 0.0);
    for (int k = 0; k < r_; ++k) {
      double scale = 0;
      for (int h = 0; h < m_; ++h) scale += p_.scale[k * m_ + h] / m_;
      for (int i = 0; i < n_; ++i) {
        value[i] += kSizeOverTie * (p_.weight[k] * scale + p_.price[k]) * p_.need(i)[k];
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

  void connect() {
    for (int a = 0; a < m_; ++a) {
      for (int b = 0; b < m_; ++b) far_.push_back(p_.far(a, b));
    }
    later_start_.assign(n_ + 1, 0);
    for (int d = 0; d < n_; ++d) {
      for (const Neighbour& other : p_.neighbours(order_[d])) {
        const int depth = depth_of_[other.unit];
        if (depth > d) later_.push_back({depth, other.overhead});
      }
      later_start_[d + 1] = later_.size();
    }
  }

  // Of computers that are alike and still empty, only the first need be tried.
  void find_twins() {
    twin_.assign(m_, -1);
    if (!p_.cost.empty() || !p_.distance.empty() || !p_.bandwidth.empty()) return;
    for (int h = 1; h < m_; ++h) {
      for (int g = h - 1; g >= 0 && twin_[h] < 0; --g) {
        bool same = !p_.time_limits || p_.time_limits->alike(h, g);
        for (int k = 0; k < r_ && same; ++k) {
          same = p_.capacity[k * m_ + h] == p_.capacity[k * m_ + g] &&
                 p_.floor[k * m_ + h] == p_.floor[k * m_ + g] &&
                 p_.goal[k * m_ + h] == p_.goal[k * m_ + g];
        }
        for (int i = 0; i < n_ && same; ++i) same = p_.allowed(i, h) == p_.allowed(i, g);
        if (same) twin_[h] = g;
      }
    }
  }

  void measure() {
    need_.resize(static_cast<std::size_t>(n_) * r_);
    open_.assign(static_cast<std::size_t>(n_ + 1) * r_, 0.0);
    for (int d = n_ - 1; d >= 0; --d) {
      for (int k = 0; k < r_; ++k) {
        need_[d * r_ + k] = p_.need(order_[d])[k];
        open_[d * r_ + k] = open_[(d + 1) * r_ + k] + need_[d * r_ + k];
      }
    }
    for (int k = 0; k < r_; ++k) levelling_.emplace_back(p_, k);
    saved_.resize(later_.size() * static_cast<std::size_t>(m_ + 1));
    branch_.resize(static_cast<std::size_t>(n_ + 1) * m_);
  }

  void descend() override {
    unary_.resize(static_cast<std::size_t>(n_) * m_);
    least_.resize(n_);
    paid_ = least_sum_ = 0;
    for (int d = 0; d < n_; ++d) {
      double* row = &unary_[static_cast<std::size_t>(d) * m_];
      for (int h = 0; h < m_; ++h) {
        row[h] = p_.allowed(order_[d], h) ? p_.linear(order_[d], h) : kInfinity;
      }
      least_[d] = *std::min_element(row, row + m_);
      least_sum_ += least_[d];
    }
    left_ = p_.capacity;
    units_on_.assign(m_, 0);
    traffic_.assign(p_.bandwidth.size(), 0.0);
    if (times_) time_ = times_->reset(Placement(n_, -1));
    if (time_.broken == 0) open(0);
  }

  void open(int depth) {
    if (depth == n_) return found();
    Branch* branch = branch_.data() + static_cast<std::size_t>(depth) * m_;
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

  double paid() const { return paid_ + time_.paid; }

  // The computers worth trying, most promising first.
  int branches(int depth, Branch* out) {
    int count = 0;
    const double rest = paid() + least_sum_ - least_[depth];
    const double* unary = unary_.data() + static_cast<std::size_t>(depth) * m_;
    for (int h = 0; h < m_; ++h) {
      double bound = rest + unary[h];
      if (bound >= threshold_ || !fits(depth, h)) continue;
      for (int k = 0; k < r_ && bound < threshold_; ++k) {
        if (p_.weight[k] > 0) bound += p_.weight[k] * imbalance(depth, k, h);
        if (p_.price[k] > 0) bound += p_.price[k] * shortage(depth, k, h);
      }
      if (times_ && bound < threshold_) {
        const TimeSum change = times_->weigh(order_[depth], h);
        if (change.broken > 0) continue;
        bound += change.paid;
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
      if (left_[k * m_ + h] - need[k] < p_.floor[k * m_ + h]) return false;
    }
    for (const std::int32_t other : p_.apart(order_[depth])) {
      if (depth_of_[other] == depth) return false;
      if (depth_of_[other] < depth && at_[depth_of_[other]] == h) return false;
    }
    return true;
  }

  // The least spread of a resource when the unit at `depth` goes to `computer` and what
  // is open flows freely.
  double imbalance(int depth, int k, int computer) const {
    const double* scale = p_.scale.data() + static_cast<std::size_t>(k) * m_;
    double share[kMostComputers];
    for (int h = 0; h < m_; ++h) share[h] = left_[k * m_ + h] * scale[h];
    share[computer] -= need_[depth * r_ + k] * scale[computer];
    const Levelling& levelling = levelling_[k];
    return relaxed_spread(share, levelling.size.data(), m_, p_.counted[k], levelling.level,
                          open_[(depth + 1) * r_ + k], p_.variance, levelling.alike);
  }

  // The least shortage of a priced resource, likewise.
  double shortage(int depth, int k, int computer) const {
    double left[kMostComputers];
    for (int h = 0; h < m_; ++h) left[h] = left_[k * m_ + h];
    left[computer] -= need_[depth * r_ + k];
    return relaxed_shortage(p_, k, left, open_[(depth + 1) * r_ + k]);
  }

  // Place the unit at `depth`; false when it cannot become better than the best.
  bool enter(int depth, int computer) {
    at_[depth] = computer;
    ++units_on_[computer];
    paid_ += unary_[depth * m_ + computer];
    least_sum_ -= least_[depth];
    const double* need = need_.data() + static_cast<std::size_t>(depth) * r_;
    for (int k = 0; k < r_; ++k) left_[k * m_ + computer] -= need[k];
    double* saved = saved_.data() + later_start_[depth] * (m_ + 1);
    const double* far = far_.data() + static_cast<std::size_t>(computer) * m_;
    for (auto e = later_start_[depth]; e < later_start_[depth + 1]; ++e) {
      const int d = later_[e].depth;
      double* row = unary_.data() + static_cast<std::size_t>(d) * m_;
      double least = kInfinity;
      for (int h = 0; h < m_; ++h) {
        saved[h] = row[h];
        row[h] += later_[e].overhead * far[h];
        least = row[h] < least ? row[h] : least;
      }
      saved[m_] = least_[d];
      saved += m_ + 1;
      least_sum_ += least - least_[d];
      least_[d] = least;
    }
    const bool holds = p_.bandwidth.empty() || send(depth, computer, 1.0);
    if (times_) time_ = times_->put(order_[depth], computer);
    return holds && paid() + least_sum_ < threshold_;
  }

  void leave(int depth, int computer) {
    if (times_) time_ = times_->take_back();
    if (!p_.bandwidth.empty()) send(depth, computer, -1.0);
    const double* saved = saved_.data() + later_start_[depth] * (m_ + 1);
    for (auto e = later_start_[depth]; e < later_start_[depth + 1]; ++e) {
      const int d = later_[e].depth;
      double* row = unary_.data() + static_cast<std::size_t>(d) * m_;
      for (int h = 0; h < m_; ++h) row[h] = saved[h];
      least_sum_ += saved[m_] - least_[d];
      least_[d] = saved[m_];
      saved += m_ + 1;
    }
    const double* need = need_.data() + static_cast<std::size_t>(depth) * r_;
    for (int k = 0; k < r_; ++k) left_[k * m_ + computer] += need[k];
    least_sum_ += least_[depth];
    paid_ -= unary_[depth * m_ + computer];
    --units_on_[computer];
  }

  // Add or take away the traffic of the unit at `depth` to those before it; whether all
  // links hold it.
  bool send(int depth, int computer, double sign) {
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

  std::vector<std::int32_t> depth_of_;    // unit -> depth
  std::vector<std::size_t> later_start_;  // (n + 1)
  std::vector<Later> later_;
  std::vector<double> far_;    // (m, m)
  std::vector<double> need_;   // (n, r) by depth
  std::vector<double> open_;   // (n + 1, r): demand from a depth on
  std::vector<Levelling> levelling_;  // (r)
  std::vector<int> twin_;      // (m): the computer before it that is just like it, or -1

  // What changes from node to node.
  std::vector<double> unary_;    // (n, m) by depth: towards placed units, and linear
  std::vector<double> least_;    // (n): the smallest of each row
  std::vector<double> saved_;    // (later, m + 1): rows and `least_` as they were
  std::vector<double> left_;     // (r, m)
  std::vector<double> traffic_;  // (m, m), of a larger and a smaller index
  std::vector<int> units_on_;    // (m)
  std::optional<Times> times_;   // where there are time limits
  TimeSum time_;                 // what these come to
  std::vector<Branch> branch_;   // (n, m)
  double paid_ = 0, least_sum_ = 0;
};

}  // namespace

std::unique_ptr<Tree> Tree::of(const Problem& problem) {
  if (FrontierTree::takes(problem)) {
    auto tree = std::make_unique<FrontierTree>(problem);
    if (tree->narrow()) return tree;
  }
  return std::make_unique<AnyTree>(problem);
}

}  // namespace poise
