#include "process_tree.h"

#include <dirent.h>
#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cinttypes>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <iterator>
#include <memory>

#include "cpu_share.h"
#include "kernel_counters.h"

namespace poise {

static constexpr std::int64_t look_every = 1'000'000'000;  // [ns]

static std::int64_t tick() {
  static const std::int64_t length = 1'000'000'000 / sysconf(_SC_CLK_TCK);
  return length;
}

static std::string content(const std::string& path) {
  std::string text;
  const int descriptor = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) return text;
  char part[4096];
  for (ssize_t length; (length = ::read(descriptor, part, sizeof(part))) > 0;)
    text.append(part, static_cast<std::size_t>(length));
  close(descriptor);
  return text;
}

bool ProcessTree::read(std::int64_t& used) {
  if (!root_.read_own()) return false;
  const std::int64_t now = wall_now();
  bool is_due = now >= look_at_ || (is_close_ && had_descendants_);
  for (Process& each : descendants_) is_due |= !each.read_own();
  if (is_due) {
    look();
    look_at_ = now + look_every;
  }
  std::int64_t total = root_.cpu + root_.ended;
  for (const Process& each : descendants_) total += each.cpu + each.ended;
  used = never_less(total);
  return true;
}

std::vector<int> ProcessTree::descendants() const {
  std::vector<int> found;
  for (const Process& each : descendants_) found.push_back(each.number);
  return found;
}

bool ProcessTree::Process::read_own() { return read_cpu(process_cpu_clock(number), cpu); }

bool ProcessTree::Process::read_ended(const std::string& proc) {
  const std::string stat = content(proc + "/" + std::to_string(number) + "/stat");
  // the name, in brackets, may hold anything; 13 fields on come the times of children
  const auto after_name = stat.rfind(')');
  std::int64_t user = 0, system = 0;
  std::uint64_t now = 0;
  if (after_name == std::string::npos ||
      std::sscanf(stat.c_str() + after_name + 1,
                  " %*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %*u %*u"
                  " %" SCNd64 " %" SCNd64 " %*d %*d %*d %*d %" SCNu64,
                  &user, &system, &now) != 3)
    return false;
  if (started && started != now) return false;  // another one has its number
  started = now;
  ended = (user + system) * tick();
  return true;
}

template <typename Condition>
bool ProcessTree::drop(Condition is_gone) {
  const auto gone = std::stable_partition(descendants_.begin(), descendants_.end(),
                                          [&](Process& each) { return !is_gone(each); });
  const bool were_any = gone != descendants_.end();
  for (auto each = gone; each != descendants_.end(); ++each)
    if (each->is_child) ended_[each->starter] += each->cpu + each->ended;
  descendants_.erase(gone, descendants_.end());
  return were_any;
}

std::int64_t ProcessTree::started_by(int thread) const {
  const auto ended = ended_.find(thread);
  std::int64_t used = ended == ended_.end() ? 0 : ended->second;
  for (const Process& each : descendants_)
    if (each.starter == thread) used += each.cpu + each.ended;
  return used;
}

// What ended meanwhile may be in its parent's time already: look again then.
void ProcessTree::look() {
  const auto has_ended = [](Process& each) { return !each.read_own(); };
  const auto is_gone = [this](Process& each) { return !each.read_ended(proc_); };
  bool is_whole = false;
  while (!is_whole) {
    drop(has_ended);
    root_.read_ended(proc_);
    is_whole = !drop(is_gone);
    add_children_of(root_);
    for (std::size_t i = 0; i < descendants_.size(); ++i)  // grows meanwhile
      add_children_of(descendants_[i]);
    had_descendants_ |= !descendants_.empty() || root_.ended > 0;
    is_whole = !drop(has_ended) && is_whole;
  }
  forget_ended_threads();
}

void ProcessTree::forget_ended_threads() {
  const std::string tasks = proc_ + "/" + std::to_string(root_.number) + "/task/";
  for (auto each = ended_.begin(); each != ended_.end();) {
    const bool is_there = access((tasks + std::to_string(each->first)).c_str(), F_OK) == 0;
    each = is_there ? std::next(each) : ended_.erase(each);
  }
}

void ProcessTree::add_children_of(Process parent) {
  const std::string tasks = proc_ + "/" + std::to_string(parent.number) + "/task";
  const std::unique_ptr<DIR, int (*)(DIR*)> folder(opendir(tasks.c_str()), closedir);
  if (!folder) return;
  while (const dirent* thread = readdir(folder.get())) {
    if (thread->d_name[0] == '.') continue;
    const std::string children = content(tasks + "/" + thread->d_name + "/children");
    const char* rest = children.c_str();
    for (char* end; const long next = std::strtol(rest, &end, 10); rest = end) {
      Process child{static_cast<int>(next)};
      child.is_child = !parent.starter;
      child.starter = child.is_child ? std::atoi(thread->d_name) : parent.starter;
      const auto is_it = [&](const Process& each) { return each.number == child.number; };
      if (std::none_of(descendants_.begin(), descendants_.end(), is_it) && child.read_own() &&
          child.read_ended(proc_))
        descendants_.push_back(child);
    }
  }
}

// Ticks are cut off, so the total may fall a little when a child ends. If it falls by more,
// nobody took note of that end.
std::int64_t ProcessTree::never_less(std::int64_t total) {
  const auto counts = static_cast<std::int64_t>(2 * (descendants_.size() + 1));
  const std::int64_t fall = last_ - (total + lost_);
  if (fall > counts * tick()) lost_ += fall;
  last_ = std::max(last_, total + lost_);
  return last_;
}

}  // namespace poise
