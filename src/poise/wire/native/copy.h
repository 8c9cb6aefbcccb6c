// Copies into memory that another process reads.
#pragma once

#include <cstddef>

namespace poise {

// As `memcpy`. A block that the receiver has read is in its CPU's cache: to write it piece by
// piece first fetches each line from there. `rep movsb` writes whole lines and fetches none,
// where the CPU has it in this form.
void copy_shared(void* target, const void* source, std::size_t size);

}  // namespace poise
