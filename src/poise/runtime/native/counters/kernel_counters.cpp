#include "kernel_counters.h"

#include <fcntl.h>
#include <unistd.h>

#include <cinttypes>
#include <cstdio>
#include <cstring>

namespace poise {

bool read_cpu(clockid_t clock, std::int64_t& used) {
  timespec now{};
  if (clock_gettime(clock, &now) != 0) return false;
  used = now.tv_sec * 1'000'000'000LL + now.tv_nsec;
  return true;
}

ThreadCounters::ThreadCounters(const std::string& proc, int thread) : thread_(thread) {
  const std::string folder = proc + "/" + std::to_string(thread);
  descriptor_ = open((folder + "/schedstat").c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor_ >= 0) return;
  // a kernel without CONFIG_SCHED_INFO
  has_wait_ = false;
  descriptor_ = open((folder + "/stat").c_str(), O_RDONLY | O_CLOEXEC);
}

ThreadCounters::~ThreadCounters() {
  if (descriptor_ >= 0) close(descriptor_);
}

bool ThreadCounters::read() {
  char text[1024];
  const ssize_t length = pread(descriptor_, text, sizeof(text) - 1, 0);
  if (length <= 0) return false;
  text[length] = '\0';
  return parse(text);
}

bool ThreadCounters::parse(const char* text) {
  if (has_wait_) return std::sscanf(text, "%" SCNd64 " %" SCNd64, &cpu, &wait) == 2;
  // the name, in brackets, may hold anything; 11 fields on come user and system time
  const char* after_name = std::strrchr(text, ')');
  std::int64_t user = 0, system = 0;
  if (!after_name || std::sscanf(after_name + 1,
                                 " %*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u"
                                 " %" SCNd64 " %" SCNd64,
                                 &user, &system) != 2)
    return false;
  cpu = (user + system) * (1'000'000'000 / sysconf(_SC_CLK_TCK));
  return true;
}

}  // namespace poise
