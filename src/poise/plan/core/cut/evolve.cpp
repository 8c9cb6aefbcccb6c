#include "evolve.h"

#include <algorithm>

#include "bisect.h"
#include "flow.h"

namespace poise::cut {
namespace {

// Of divisions from nothing, one in so many is made with care and the others quickly: what
// is made with care is good, but all of it alike.
constexpr int kCareful = 3;
// So many nodes for each block are left when blocks are first made, and so often each
// halving is tried; with care, and quickly.
constexpr struct {
  int enough, tries;
} kWays[] = {{200, 8}, {40, 1}};
// What a joined node may weigh, in shares of the mean of the smallest level's nodes.
constexpr double kHeaviest = 1.5;
// And when a division is made better.
constexpr int kAgain = 20;
constexpr int kPopulation = 6;
// Which part of the effort goes into the first divisions from nothing.
constexpr double kFresh = 0.25;
// After so many without a better best, a population that is not full gets one more from
// nothing, and a full one is given up; so many give their best.
constexpr int kStuck = 2, kPatience = 20, kEpochs = 4;

struct Division {
  Blocks block;
  std::int64_t cut = 0;
  double over = 0;  // by how much limits are broken
  bool better_than(const Division& other) const {
    return over != other.over ? over < other.over : cut < other.cut;
  }
};

class Evolution {
 public:
  Evolution(const Graph& graph, const std::vector<double>& limit, Stop& stop,
            Random& random, const std::function<void(const Blocks&)>& offer)
      : graph_(graph), limit_(limit), stop_(stop), random_(random),
        refiner_(stop, random), flow_(stop, random), offer_(offer), total_(graph.total()) {}

  void run(const Blocks& known) {
    if (!known.empty()) add(weighed(known));
    // A population that leads no further makes way for another; its best comes back
    // later, to be joined with the best of the next.
    std::vector<Division> champions;
    for (int epoch = 0; epoch == 0 || (best_ != 0 && !stop_.look()); ++epoch) {
      begin(epoch);
      if (best_ < 0 && epoch > 0) return;  // nothing that holds; others may do better
      mature();
      champions.push_back(best_of_all());
      all_.clear();
      if (epoch % kEpochs != kEpochs - 1) continue;
      all_ = std::move(champions);
      champions.clear();
      mature();
      champions.push_back(best_of_all());
      all_.clear();
    }
  }

 private:
  // Divisions from nothing: at least one, and as many as there is time for.
  void begin(int epoch) {
    const double until = epoch == 0 ? kFresh : 1.0;
    do {
      add(fresh());
    } while (static_cast<int>(all_.size()) < kPopulation && !stop_.look() &&
             stop_.spent() < until);
  }

  // Breed until nothing better has come for long.
  void mature() {
    int idle = 0;
    while (!stop_.look() && idle < kPatience) {
      const int size = static_cast<int>(all_.size());
      bool better = false;
      if (size < kPopulation && idle == kStuck) {
        better = add(fresh());
        idle = -1;
      } else if (size == 1 || random_.below(10) == 0) {
        better = add(again(all_[pick()]));
      } else {
        const int a = pick();
        int b = pick();
        if (a == b) b = (a + 1 + random_.below(size - 1)) % size;
        better = add(child(all_[a], all_[b]));
      }
      idle = better ? 0 : idle + 1;
    }
  }

  Division best_of_all() const {
    const auto worse = [](const Division& a, const Division& b) { return b.better_than(a); };
    return *std::max_element(all_.begin(), all_.end(), worse);
  }

  Division weighed(Blocks block) const {
    Division out;
    out.cut = cut_of(graph_, block);
    out.over = Refiner::excess(graph_, limit_, block);
    out.block = std::move(block);
    return out;
  }

  // The better of two at random.
  int pick() {
    const int size = static_cast<int>(all_.size());
    const int a = random_.below(size), b = random_.below(size);
    return all_[a].better_than(all_[b]) ? a : b;
  }

  Division fresh() {
    const auto [many, tries] = kWays[fresh_++ % kCareful == 0 ? 0 : 1];
    const int enough = std::max(many * static_cast<int>(limit_.size()), 200);
    const Levels levels(graph_, {}, enough, kHeaviest * total_ / enough, random_);
    return grown(levels, bisect(levels.smallest(), limit_, tries, stop_, random_));
  }

  // Refine on every level, from the smallest on.
  Division grown(const Levels& levels, Blocks block) {
    for (int level = levels.count() - 1; level > 0; --level) {
      refine(levels.at(level), block);
      block = levels.up(level, block);
    }
    refine(graph_, block);
    return weighed(std::move(block));
  }

  void refine(const Graph& graph, Blocks& block) {
    refiner_.run(graph, limit_, block);
    if (flow_.run(graph, limit_, block) > 0) refiner_.run(graph, limit_, block);
  }

  // Join what is in one block, and refine it from there.
  Division again(const Division& one) { return regrown(one, one.block); }

  // Join what is in one block in both: what one has better can be taken over by moves of
  // whole pieces. The better of the two is where it starts.
  Division child(const Division& a, const Division& b) {
    const auto k = static_cast<std::int32_t>(limit_.size());
    Blocks group(graph_.size());
    for (int u = 0; u < graph_.size(); ++u) group[u] = a.block[u] * k + b.block[u];
    return regrown(a.better_than(b) ? a : b, group);
  }

  Division regrown(const Division& from, const Blocks& group) {
    const int k = static_cast<int>(limit_.size());
    const int enough = std::max(kAgain * k, 50);
    const double heaviest = kHeaviest * total_ / enough;
    const Levels levels(graph_, group, enough, heaviest, random_);
    return grown(levels, levels.down(from.block));
  }

  // Take one into the population, in place of the most similar of those that are no
  // better when it is full; whether it is the best there.
  bool add(Division one) {
    if (one.over == 0 && (best_ < 0 || one.cut < best_)) {
      best_ = one.cut;
      offer_(one.block);
    }
    bool best = true;
    int out = -1, least = 0;
    for (int i = 0; i < static_cast<int>(all_.size()); ++i) {
      if (!one.better_than(all_[i])) best = false;
      if (all_[i].better_than(one)) continue;
      const int different = difference(all_[i].block, one.block);
      if (out >= 0 && different >= least) continue;
      out = i;
      least = different;
    }
    if (static_cast<int>(all_.size()) < kPopulation) all_.push_back(std::move(one));
    else if (out >= 0) all_[out] = std::move(one);
    return best;
  }

  // How many edges one of the two cuts and the other does not.
  int difference(const Blocks& a, const Blocks& b) const {
    int count = 0;
    for (int u = 0; u < graph_.size(); ++u) {
      for (const Edge& e : Around(graph_, u)) {
        count += (a[u] != a[e.to]) != (b[u] != b[e.to]);
      }
    }
    return count;
  }

  const Graph& graph_;
  const std::vector<double>& limit_;
  Stop& stop_;
  Random& random_;
  Refiner refiner_;
  Flow flow_;
  const std::function<void(const Blocks&)>& offer_;
  double total_;
  std::vector<Division> all_;
  std::int64_t best_ = -1;
  int fresh_ = 0;  // how many were made from nothing
};

}  // namespace

void evolve(const Graph& graph, const std::vector<double>& limit, const Blocks& known,
            Stop& stop, Random& random, const std::function<void(const Blocks&)>& offer) {
  Evolution(graph, limit, stop, random, offer).run(known);
}

}  // namespace poise::cut
