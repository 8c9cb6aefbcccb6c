#include "running_call.h"

#include <sys/syscall.h>
#include <unistd.h>

namespace poise {

std::int32_t ask_thread_number() {
  return thread_number = static_cast<std::int32_t>(syscall(SYS_gettid));
}

}  // namespace poise
