// Definitions that all kernels share. The tests' emulator (tests/emulator/cuda.h) provides the same names on a CPU.
#pragma once

#include <cstddef>
#include <cstdint>

#include "inline.h"

constexpr unsigned ALL_LANES = 0xffffffffu;
constexpr int WARP = 32;

#ifdef __CUDACC__

// Declares `name`: the dynamic shared memory of the block, as a T.
#define DYNAMIC_SHARED(T, name)                                          \
    extern __shared__ __align__(16) unsigned char dynamic_shared_memory[]; \
    T& name = *reinterpret_cast<T*>(dynamic_shared_memory)

namespace splatrl {

SPLAT_INLINE float half_to_float(uint16_t half) {
    float out;
    asm("cvt.f32.f16 %0, %1;" : "=f"(out) : "h"(half));
    return out;
}

// Two floats as the nearest half floats, `low` in the low bits.
SPLAT_INLINE uint32_t halves_of(float low, float high) {
    uint32_t out;
    asm("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(out) : "f"(high), "f"(low));
    return out;
}

SPLAT_INLINE uint64_t bits_of(double value) { return uint64_t(__double_as_longlong(value)); }

// Prefetch the data at an address into the L2 cache, which all multiprocessors share.
SPLAT_INLINE void prefetch_to_shared_cache(const void* at) { asm volatile("prefetch.global.L2 [%0];" ::"l"(at)); }
// Prefetch the data at an address into the L1 cache, the multiprocessor's own.
SPLAT_INLINE void prefetch_to_own_cache(const void* at) { asm volatile("prefetch.global.L1 [%0];" ::"l"(at)); }

}  // namespace splatrl

#endif

namespace splatrl {

SPLAT_INLINE int thread() { return int(threadIdx.x); }
SPLAT_INLINE int lane() { return int(threadIdx.x % WARP); }
SPLAT_INLINE int warp() { return int(threadIdx.x / WARP); }

SPLAT_INLINE float low_half(uint32_t halves) { return half_to_float(uint16_t(halves)); }
SPLAT_INLINE float high_half(uint32_t halves) { return half_to_float(uint16_t(halves >> 16)); }

// Number of lanes before this one whose bit is set in `lanes`.
SPLAT_INLINE int rank_in(unsigned lanes) { return __popc(lanes & ((1u << lane()) - 1u)); }

}  // namespace splatrl
