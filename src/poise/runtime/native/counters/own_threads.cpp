#include "own_threads.h"

#include <dirent.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <iterator>

namespace poise {

static std::string name_of(const std::string& folder) {
  std::string name;
  std::getline(std::ifstream(folder + "/comm"), name);
  return name;
}

void OwnThreads::look(const std::vector<int>& components) {
  const auto is_component = [&components](int thread) {
    return std::find(components.begin(), components.end(), thread) != components.end();
  };
  std::map<std::string, int> owners;  // 0: several have this name
  for (const int each : components) {
    const auto [place, is_new] = owners.emplace(name_of(tasks_ + "/" + std::to_string(each)), each);
    if (!is_new) place->second = 0;
  }
  for (auto each = owned_.begin(); each != owned_.end();)
    each = is_component(each->first) ? std::next(each) : owned_.erase(each);
  const std::unique_ptr<DIR, int (*)(DIR*)> folder(opendir(tasks_.c_str()), closedir);
  if (!folder) return;
  while (const dirent* entry = readdir(folder.get())) {
    const int thread = std::atoi(entry->d_name);
    if (!thread || thread == main_ || is_component(thread)) continue;
    const auto owner = owners.find(name_of(tasks_ + "/" + entry->d_name));
    if (owner == owners.end() || !owner->second) continue;
    auto& counters = owned_[owner->second].threads[thread];
    if (!counters) counters = std::make_unique<ThreadCounters>(proc_, thread);
  }
}

std::int64_t OwnThreads::cpu(int component) {
  const auto found = owned_.find(component);
  if (found == owned_.end()) return 0;
  Owned& owned = found->second;
  std::int64_t used = 0;
  for (auto each = owned.threads.begin(); each != owned.threads.end();) {
    ThreadCounters& counters = *each->second;
    if (counters.read()) {
      used += counters.cpu;
      ++each;
    } else {
      owned.ended += counters.cpu;
      each = owned.threads.erase(each);
    }
  }
  return owned.ended + used;
}

}  // namespace poise
