// Twice as many numbers at once where the processor can; the results are the same to the
// last bit, as nothing is fused or reordered.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__)
#define POISE_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define POISE_WIDE
#endif

// Becomes part of the wide function that calls it.
#define POISE_INLINE inline __attribute__((always_inline))
