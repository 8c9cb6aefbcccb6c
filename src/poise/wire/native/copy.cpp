#include "copy.h"

#include <cstring>

#if defined(__x86_64__)
#include <cpuid.h>
#endif

namespace poise {

#if defined(__x86_64__)
namespace {

// Fewer bytes than these take longer to begin with than to copy.
constexpr std::size_t large = 1 << 14;

bool has_fast_movsb() {
  constexpr unsigned extended_features = 7, erms = 1u << 9;  // of ebx
  unsigned eax = 0, ebx = 0, ecx = 0, edx = 0;
  return __get_cpuid_count(extended_features, 0, &eax, &ebx, &ecx, &edx) && (ebx & erms);
}

}  // namespace

void copy_shared(void* target, const void* source, std::size_t size) {
  static const bool is_fast = has_fast_movsb();
  if (is_fast && size >= large)
    __asm__ volatile("rep movsb" : "+D"(target), "+S"(source), "+c"(size) : : "memory");
  else
    std::memcpy(target, source, size);
}
#else
void copy_shared(void* target, const void* source, std::size_t size) {
  std::memcpy(target, source, size);
}
#endif

}  // namespace poise
