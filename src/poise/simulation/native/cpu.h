// The cores of a computer as a fluid: what runs at one time shares them by weight.
//
// Rates change only when something begins, ends, pauses or reaches its quota, so time
// jumps to the next such moment. A quota is no cap of the rate: it is a bucket that each
// period refills, and a group whose bucket is empty stands until then.
#pragma once

#include <cstdint>
#include <deque>
#include <limits>
#include <vector>

#include "events.h"

namespace poise::simulation {

// What a group would use at most [cores], and its weight.
struct CpuClaim {
  double weight;
  double most;
};

// What each claim gets [cores]: weighted max-min fairness with caps. No claim gets more
// than it can use; what that leaves goes to the others by their weights.
std::vector<double> shares(double cores, const std::vector<CpuClaim>& claims);

class Cpu;

// The threads of a container, or of another program. It uses no more than `most` cores at
// once: 1 where an interpreter's lock lets one thread run at a time. `quota` is the CPU
// time that it may use each second [cores].
class CpuGroup {
 public:
  CpuGroup(Cpu& cpu, double weight, double most, double quota);
  CpuGroup(const CpuGroup&) = delete;
  CpuGroup& operator=(const CpuGroup&) = delete;

  // Begin to work [core-seconds]; `then` is called when it is done. What is done meanwhile
  // is added to `used`.
  void run(double work, Action then, double* used = nullptr);
  // Stand still, or go on.
  void pause(bool is_paused);
  // Do nothing more.
  void end();

  double weight() const { return weight_; }
  void set_weight(double weight);
  // CPU time so far [s].
  double used() const;
  // How often its quota ran out.
  std::uint64_t throttled() const { return throttled_; }

 private:
  friend class Cpu;
  struct Job {
    double left;
    Action then;
    double* used;
  };

  // What it would use now [cores].
  double could_use() const;
  void advance(double seconds);

  Cpu& cpu_;
  double weight_, most_, quota_, bucket_;
  double used_ = 0.0, rate_ = 0.0;
  std::uint64_t throttled_ = 0;
  bool is_paused_ = false;
  std::vector<Job> jobs_;
};

// The cores of one computer; `speed` is the work that each does in a second [core-seconds
// of the reference]. An emulated one has cores of the reference instead, and does no more
// in each `emulated_period` than it would do: it runs quickly, and then stands.
class Cpu {
 public:
  Cpu(Events& events, double cores, double speed, bool is_emulated);
  Cpu(const Cpu&) = delete;
  Cpu& operator=(const Cpu&) = delete;

  CpuGroup& group(double weight, double most, double quota);
  double cores() const { return cores_; }
  double speed() const { return speed_; }
  // CPU time of all groups so far [s].
  double used();

 private:
  friend class CpuGroup;

  // Entered by a group while it changes; several changes at once cost one.
  class Change {
   public:
    explicit Change(Cpu& cpu) : cpu_(cpu) {
      if (cpu_.depth_++ == 0) cpu_.advance();
    }
    ~Change() {
      if (--cpu_.depth_ == 0) cpu_.plan();
    }
    Change(const Change&) = delete;
    Change& operator=(const Change&) = delete;

   private:
    Cpu& cpu_;
  };

  bool is_emulated() const { return quota_ < std::numeric_limits<double>::infinity(); }
  // Let all that runs have had its share until now.
  void advance();
  // Share out again, and plan the next moment at which that changes.
  void plan();
  void share();
  // Whether there is something left of its share of CPU, if it is emulated.
  bool may_run();
  void finish_jobs();

  Events& events_;
  double cores_, speed_;
  double real_cores_, real_speed_, quota_, share_, slice_ = 0.0;
  double at_, refill_at_, next_at_;  // groups' quotas and its own are refilled then
  double ended_ = 0.0;  // CPU time of groups that have ended [s]
  int depth_ = 0;
  std::uint64_t plan_ = 0;  // an event of an earlier plan does not count
  std::deque<CpuGroup> all_;
  std::vector<CpuGroup*> groups_, busy_;
};

}  // namespace poise::simulation
