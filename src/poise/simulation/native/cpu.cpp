#include "cpu.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace poise::simulation {

constexpr double never = std::numeric_limits<double>::infinity();
// A quota is refilled this often [s], as `cpu.max` has it unless it is told.
constexpr double period = 0.1;
constexpr double emulated_period = 0.01;
// The kernel looks whether the share of an emulated computer is used up when something
// begins or ends there, and at each of its ticks [s]. It hands the share out by slices; a
// computer that idles keeps a little of one, and what it took too much [core-seconds].
constexpr double tick = 0.004;
constexpr double slice = 0.005;
constexpr double kept = 0.001;
// Less work than this is none [core-seconds].
constexpr double none = 1e-9;

std::vector<double> shares(double cores, const std::vector<CpuClaim>& claims) {
  std::vector<double> given(claims.size());
  std::vector<std::size_t> order(claims.size());
  std::iota(order.begin(), order.end(), 0U);
  // in this order each claim that is filled leaves more for all that come later
  std::stable_sort(order.begin(), order.end(), [&claims](std::size_t a, std::size_t b) {
    return claims[a].most / claims[a].weight < claims[b].most / claims[b].weight;
  });
  double weights = 0.0;
  for (const CpuClaim& claim : claims) weights += claim.weight;
  for (const std::size_t i : order) {
    given[i] = std::min(claims[i].most, cores * claims[i].weight / weights);
    cores -= given[i];
    weights -= claims[i].weight;
  }
  return given;
}

CpuGroup::CpuGroup(Cpu& cpu, double weight, double most, double quota)
    : cpu_(cpu), weight_(weight), most_(most), quota_(quota), bucket_(quota * period) {}

void CpuGroup::run(double work, Action then, double* used) {
  const Cpu::Change change(cpu_);
  jobs_.push_back({work, std::move(then), used});
  if (jobs_.size() == 1) cpu_.busy_.push_back(this);
}

void CpuGroup::pause(bool is_paused) {
  const Cpu::Change change(cpu_);
  is_paused_ = is_paused;
}

void CpuGroup::set_weight(double weight) {
  const Cpu::Change change(cpu_);
  weight_ = weight;
}

void CpuGroup::end() {
  const Cpu::Change change(cpu_);
  auto& groups = cpu_.groups_;
  const auto found = std::find(groups.begin(), groups.end(), this);
  if (found == groups.end()) return;
  groups.erase(found);
  cpu_.ended_ += used_;
  jobs_.clear();
  cpu_.busy_.erase(std::remove(cpu_.busy_.begin(), cpu_.busy_.end(), this), cpu_.busy_.end());
}

double CpuGroup::used() const {
  cpu_.advance();
  return used_;
}

double CpuGroup::could_use() const {
  if (is_paused_ || bucket_ <= none) return 0.0;
  return std::min(most_, static_cast<double>(jobs_.size()));
}

void CpuGroup::advance(double seconds) {
  const double done = rate_ * seconds;
  used_ += done;
  if (quota_ < never) {
    const bool was_full = bucket_ > none;
    bucket_ = std::max(0.0, bucket_ - done);
    throttled_ += was_full && bucket_ <= none;
  }
  const double each = done / static_cast<double>(jobs_.size());
  for (Job& job : jobs_) {
    job.left -= each;
    if (job.used != nullptr) *job.used += each;
  }
}

Cpu::Cpu(Events& events, double cores, double speed, bool is_emulated)
    : events_(events),
      cores_(cores),
      speed_(speed),
      real_cores_(is_emulated ? std::ceil(cores * speed) : cores),
      real_speed_(is_emulated ? 1.0 : speed),
      quota_(is_emulated ? cores * speed : never),
      share_(quota_ * emulated_period),
      at_(events.now()),
      refill_at_(events.now() + period),
      next_at_(events.now() + emulated_period) {}

CpuGroup& Cpu::group(double weight, double most, double quota) {
  groups_.push_back(&all_.emplace_back(*this, weight, most, quota));
  return *groups_.back();
}

double Cpu::used() {
  advance();
  double sum = ended_;
  for (const CpuGroup* group : groups_) sum += group->used_;
  return sum;
}

void Cpu::advance() {
  const double passed = events_.now() - at_;
  at_ = events_.now();
  if (passed > 0.0)
    for (CpuGroup* group : busy_) {
      slice_ -= group->rate_ * passed;
      group->advance(passed);
    }
  if (at_ >= next_at_) {
    while (next_at_ <= at_) next_at_ += emulated_period;
    share_ = quota_ * emulated_period;
  }
  if (at_ < refill_at_) return;
  while (refill_at_ <= at_) refill_at_ += period;
  for (CpuGroup* group : groups_) group->bucket_ = group->quota_ * period;
}

bool Cpu::may_run() {
  if (!is_emulated()) return true;
  if (slice_ <= none) {
    const double taken = std::min(share_, slice - slice_);
    slice_ += taken;
    share_ -= taken;
  }
  if (busy_.empty() && slice_ > kept) {
    share_ += slice_ - kept;
    slice_ = kept;
  }
  return slice_ > none;
}

void Cpu::share() {
  const bool is_running = may_run();
  double sum = 0.0;
  for (CpuGroup* group : busy_) sum += group->rate_ = is_running ? group->could_use() : 0.0;
  if (sum <= real_cores_) return;
  std::vector<CpuClaim> claims;
  for (const CpuGroup* group : busy_) claims.push_back({group->weight_, group->rate_});
  const std::vector<double> given = shares(real_cores_, claims);
  for (std::size_t i = 0; i < given.size(); ++i) busy_[i]->rate_ = given[i];
}

void Cpu::plan() {
  share();
  double first = never, total = 0.0;
  for (CpuGroup* group : busy_) {
    const double rate = group->rate_ *= real_speed_;
    total += rate;
    if (rate > 0.0) {
      double least = never;
      for (const auto& job : group->jobs_) least = std::min(least, job.left);
      first = std::min(first, at_ + least * static_cast<double>(group->jobs_.size()) / rate);
      if (group->quota_ < never) first = std::min(first, at_ + group->bucket_ / rate);
    }
    if (group->quota_ < never && (rate > 0.0 || group->bucket_ <= none))
      first = std::min(first, refill_at_);
  }
  if (is_emulated() && !busy_.empty()) first = std::min(first, next_at_);
  if (is_emulated() && total > 0.0)
    first = std::min(first, std::ceil((at_ + slice_ / total) / tick) * tick);
  ++plan_;
  if (first < never)
    events_.at(first, [this, plan = plan_] {
      if (plan == plan_) finish_jobs();
    });
}

void Cpu::finish_jobs() {
  const Change change(*this);
  std::vector<Action> done;
  for (CpuGroup* group : busy_) {
    auto& jobs = group->jobs_;
    for (auto& job : jobs)
      if (job.left <= none && job.then) done.push_back(std::move(job.then));
    jobs.erase(std::remove_if(jobs.begin(), jobs.end(),
                              [](const auto& job) { return job.left <= none; }),
               jobs.end());
  }
  busy_.erase(std::remove_if(busy_.begin(), busy_.end(),
                             [](const CpuGroup* group) { return group->jobs_.empty(); }),
              busy_.end());
  for (const Action& then : done) then();
}

}  // namespace poise::simulation
