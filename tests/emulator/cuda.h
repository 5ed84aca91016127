// CUDA's execution model on one CPU core, for tests: the threads of a block are fibers, and a few blocks run at a time.
//
// A fiber runs until it waits for others: at a barrier of its block, or in a collective of its warp. The order in which
// fibers run is drawn from a seed, so code that depends on the order of threads between two barriers gives different
// results for different seeds.
// Resident blocks take turns, so that each takes some of the work that they share. If a source has static __shared__
// variables, which exist only once here, its blocks run one after another. This header is included before a kernel's
// source, in place of what is built into NVRTC.
#pragma once

#include <setjmp.h>
#include <ucontext.h>

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <utility>

#define __global__
#define __device__
#define __host__
#define __shared__ static
#define __forceinline__ inline
#define __launch_bounds__(...)
#define __restrict__ __restrict
#define __align__(n) alignas(n)

struct alignas(8) float2 { float x, y; };
struct alignas(16) float4 { float x, y, z, w; };
struct alignas(8) uint2 { unsigned x, y; };
struct alignas(16) uint4 { unsigned x, y, z, w; };
struct alignas(16) double2 { double x, y; };
struct Index { unsigned x = 0, y = 0, z = 0; };
static inline float2 make_float2(float x, float y) { return {x, y}; }
static inline float4 make_float4(float x, float y, float z, float w) { return {x, y, z, w}; }
static inline uint2 make_uint2(unsigned x, unsigned y) { return {x, y}; }
static inline uint4 make_uint4(unsigned x, unsigned y, unsigned z, unsigned w) { return {x, y, z, w}; }

namespace emulator {

constexpr unsigned LANES = 32, MOST_THREADS = 1024, MOST_AT_ONCE = 2;
constexpr size_t STACK = 256 * 1024, MOST_SHARED = 228 * 1024;

struct Barrier {
    unsigned waiting = 0, passed = 0;
    int any = 0, every = 1, any_before = 0, every_before = 1;  // votes now, and at the last barrier that was passed
};

struct Warp {
    Barrier barrier;
    uint64_t values[2][LANES] = {};
};

struct Fiber {
    ucontext_t context;
    jmp_buf state;
    bool started = false, finished = false;
    Index thread;
    unsigned collectives = 0;
#ifdef COUNT_PASSES
    uint64_t passes[COUNT_PASSES] = {};  // since its warp last met at a barrier
#endif
};

struct Block {
    Index index;
    unsigned alive = 0;
    uint64_t random = 0;
    Barrier barrier;
    Warp warps[MOST_THREADS / LANES];
    Fiber fibers[MOST_THREADS];
    alignas(128) unsigned char shared_memory[MOST_SHARED];
};

static Block resident[MOST_AT_ONCE];  // static: sources that count passes have larger fibers
inline char* const stacks = new char[MOST_AT_ONCE * MOST_THREADS * STACK];  // unused pages take no memory
inline Block* here = nullptr;  // the block that is running
inline Fiber* running = nullptr;
inline jmp_buf scheduler;
inline unsigned threads = 0;
inline uint64_t moves = 0;  // barriers passed and threads finished, to detect deadlock
inline Index block_size, grid_size;

[[noreturn]] inline void fail(const char* why) {
    const unsigned thread = running ? running->thread.x : 0;
    std::fprintf(stderr, "emulated kernel, block %u, thread %u: %s\n", here->index.x, thread, why);
    std::abort();
}

inline void yield() {
    if (_setjmp(running->state) == 0) _longjmp(scheduler, 1);
}

#ifdef COUNT_PASSES

// How often warps passed each counted place, each as often as its busiest lane did, and how often all lanes did.
extern "C" inline uint64_t passes_of_warps[COUNT_PASSES] = {}, passes_of_lanes[COUNT_PASSES] = {};

#define PASS(what) (++emulator::running->passes[int(splatrl::Pass::what)])

// Add up and reset what the threads of these warps have counted since they last met.
inline void add_passes(unsigned begin, unsigned end) {
    for (unsigned first = begin; first < end; first += LANES)
        for (int what = 0; what < COUNT_PASSES; ++what) {
            uint64_t most = 0;
            for (unsigned i = first; i < end && i < first + LANES; ++i) {
                uint64_t& count = here->fibers[i].passes[what];
                most = most > count ? most : count;
                passes_of_lanes[what] += count, count = 0;
            }
            passes_of_warps[what] += most;
        }
}

#else
inline void add_passes(unsigned, unsigned) {}
#endif

// Wait until `count` fibers have arrived; `first_thread` is the index of the first of them.
inline void meet(Barrier& barrier, unsigned count, unsigned first_thread, int vote = 0) {
    barrier.any |= vote != 0, barrier.every &= vote != 0;
    const unsigned turn = barrier.passed;
    if (++barrier.waiting == count) {
        barrier.waiting = 0;
        barrier.any_before = barrier.any, barrier.every_before = barrier.every;
        barrier.any = 0, barrier.every = 1;
        ++barrier.passed, ++moves;
        add_passes(first_thread, first_thread + count);
        return;
    }
    while (barrier.passed == turn) yield();
}

inline Warp& warp() { return here->warps[running->thread.x / LANES]; }

inline unsigned warp_size() {
    const unsigned first = running->thread.x / LANES * LANES;
    return threads - first < LANES ? threads - first : LANES;
}

// Contribute the value of this lane, and return the values of all lanes of its warp.
inline const uint64_t* exchange(unsigned mask, uint64_t value) {
    if (mask != 0xffffffffu) fail("expected a collective of all 32 lanes");
    if (warp_size() != LANES) fail("expected whole warps");
    uint64_t* values = warp().values[running->collectives++ % 2];
    values[running->thread.x % LANES] = value;
    meet(warp().barrier, LANES, running->thread.x / LANES * LANES);
    return values;
}

template <class T>
uint64_t to_bits(T value) {
    static_assert(sizeof(T) <= sizeof(uint64_t), "at most eight bytes");
    uint64_t bits = 0;
    std::memcpy(&bits, &value, sizeof(T));
    return bits;
}

template <class T>
T from_bits(uint64_t bits) {
    T value;
    std::memcpy(&value, &bits, sizeof(T));
    return value;
}

inline void (*body)(void*) = nullptr;
inline void* body_arguments = nullptr;

inline void enter() {
    body(body_arguments);
    running->finished = true;
    --here->alive, ++moves;
    _longjmp(scheduler, 1);
}

inline void resume(Fiber& fiber, char* stack) {
    running = &fiber;
    if (_setjmp(scheduler) != 0) return;
    if (fiber.started) _longjmp(fiber.state, 1);
    fiber.started = true;
    getcontext(&fiber.context);
    fiber.context.uc_stack.ss_sp = stack;
    fiber.context.uc_stack.ss_size = STACK;
    fiber.context.uc_link = nullptr;
    makecontext(&fiber.context, enter, 0);
    setcontext(&fiber.context);
}

inline void begin(Block& block, unsigned index, uint64_t seed) {
    block.index.x = index, block.alive = threads;
    block.barrier = Barrier{};
    for (Warp& one : block.warps) one = Warp{};
    for (unsigned i = 0; i < threads; ++i) {
        block.fibers[i] = Fiber{};
        block.fibers[i].thread.x = i;
    }
    std::memset(block.shared_memory, 0xcd, MOST_SHARED);  // garbage, which exposes reads of uninitialised memory
    block.random = seed * 0x9e3779b97f4a7c15ull + index + 1;
}

// Let each thread of a block run until it next waits.
inline void take_turn(Block& block, uint64_t seed) {
    here = &block;
    block.random = block.random * 6364136223846793005ull + 1442695040888963407ull;
    char* const first_stack = stacks + (&block - resident) * MOST_THREADS * STACK;
    const unsigned first = seed == 0 ? 0 : unsigned(block.random >> 33) % threads;
    const unsigned stride = seed == 0 || block.random >> 63 == 0 ? 1 : threads - 1;  // forwards or backwards
    for (unsigned i = 0, at = first; i < threads; ++i, at = (at + stride) % threads)
        if (!block.fibers[at].finished) resume(block.fibers[at], first_stack + at * STACK);
    running = nullptr;
}

inline void run_blocks(unsigned count, unsigned at_once, uint64_t seed) {
    unsigned begun = 0;
    for (bool more = true; more;) {
        more = false;
        const uint64_t before = moves;
        for (unsigned i = 0; i < at_once; ++i) {
            Block& block = resident[i];
            if (block.alive == 0 && begun < count) begin(block, begun++, seed);
            if (block.alive == 0) continue;
            take_turn(block, seed);
            more = true;
        }
        if (more && moves == before) fail("threads wait for others that never come");
    }
}

template <class... A, size_t... I>
void call(void (*kernel)(A...), void** arguments, std::index_sequence<I...>) {
    kernel(*static_cast<std::remove_reference_t<A>*>(arguments[I])...);
}


template <class... A>
void launch(void (*kernel)(A...), unsigned blocks, unsigned count, void** arguments, unsigned at_once, uint64_t seed) {
    if (count > MOST_THREADS) fail("expected at most 1024 threads");
    struct Bound {
        void (*kernel)(A...);
        void** arguments;
    } bound{kernel, arguments};
    body = [](void* what) {
        Bound& it = *static_cast<Bound*>(what);
        call(it.kernel, it.arguments, std::index_sequence_for<A...>{});
    };
    body_arguments = &bound;
    block_size.x = threads = count, grid_size.x = blocks;
    run_blocks(blocks, at_once, seed);
}

}  // namespace emulator

#define threadIdx (emulator::running->thread)
#define blockIdx (emulator::here->index)
#define blockDim (emulator::block_size)
#define gridDim (emulator::grid_size)
#define DYNAMIC_SHARED(T, name)                                                  \
    static_assert(sizeof(T) <= emulator::MOST_SHARED, "too much shared memory"); \
    T& name = *reinterpret_cast<T*>(emulator::here->shared_memory)

static inline void __syncthreads() { emulator::meet(emulator::here->barrier, emulator::here->alive, 0); }
static inline int __syncthreads_or(int vote) {
    emulator::meet(emulator::here->barrier, emulator::here->alive, 0, vote);
    return emulator::here->barrier.any_before;
}
static inline int __syncthreads_and(int vote) {
    emulator::meet(emulator::here->barrier, emulator::here->alive, 0, vote);
    return emulator::here->barrier.every_before;
}
static inline void __syncwarp(unsigned mask = 0xffffffffu) { emulator::exchange(mask, 0); }
static inline void __threadfence_block() {}
static inline unsigned __ballot_sync(unsigned mask, int vote) {
    const uint64_t* votes = emulator::exchange(mask, vote != 0);
    unsigned bits = 0;
    for (unsigned lane = 0; lane < emulator::LANES; ++lane) bits |= unsigned(votes[lane]) << lane;
    return bits;
}
static inline int __any_sync(unsigned mask, int vote) { return __ballot_sync(mask, vote) != 0; }
static inline int __all_sync(unsigned mask, int vote) { return __ballot_sync(mask, vote) == 0xffffffffu; }
template <class T>
T __shfl_sync(unsigned mask, T value, int lane) {
    return emulator::from_bits<T>(emulator::exchange(mask, emulator::to_bits(value))[lane % 32]);
}
template <class T>
T __shfl_xor_sync(unsigned mask, T value, int lanes) {
    const unsigned lane = threadIdx.x % 32;
    return emulator::from_bits<T>(emulator::exchange(mask, emulator::to_bits(value))[lane ^ unsigned(lanes)]);
}
template <class T>
T __shfl_up_sync(unsigned mask, T value, unsigned by) {
    const unsigned lane = threadIdx.x % 32;
    return emulator::from_bits<T>(emulator::exchange(mask, emulator::to_bits(value))[lane < by ? lane : lane - by]);
}

template <class T>
T atomicAdd(T* to, T value) {
    const T before = *to;
    *to = before + value;
    return before;
}
template <class T>
T atomicMin(T* to, T value) {
    const T before = *to;
    if (value < before) *to = value;
    return before;
}
template <class T>
T atomicMax(T* to, T value) {
    const T before = *to;
    if (value > before) *to = value;
    return before;
}
template <class T>
T atomicOr(T* to, T value) {
    const T before = *to;
    *to = before | value;
    return before;
}

template <class T>
T __ldg(const T* from) { return *from; }
static inline int __popc(unsigned bits) { return __builtin_popcount(bits); }
static inline int __popcll(unsigned long long bits) { return __builtin_popcountll(bits); }
static inline int __ffs(unsigned bits) { return __builtin_ffs(int(bits)); }
static inline int __ffsll(unsigned long long bits) { return __builtin_ffsll((long long)bits); }
static inline int __clz(unsigned bits) { return bits ? __builtin_clz(bits) : 32; }
static inline int __clzll(unsigned long long bits) { return bits ? __builtin_clzll(bits) : 64; }
static inline float __uint_as_float(unsigned bits) { return emulator::from_bits<float>(bits); }
static inline unsigned __float_as_uint(float value) { return unsigned(emulator::to_bits(value)); }
static inline float __int_as_float(int bits) { return emulator::from_bits<float>(unsigned(bits)); }
static inline int __float_as_int(float value) { return int(emulator::to_bits(value)); }

#include "half.h"

namespace splatrl {

static inline float half_to_float(uint16_t half) { return half == 0x7c00 ? INFINITY : from_half(half); }
static inline uint32_t halves_of(float low, float high) { return to_half(low) | uint32_t(to_half(high)) << 16; }
static inline uint64_t bits_of(double value) { return emulator::to_bits(value); }
static inline void prefetch_to_shared_cache(const void* at) { (void)*static_cast<const volatile char*>(at); }
static inline void prefetch_to_own_cache(const void* at) { (void)*static_cast<const volatile char*>(at); }

}  // namespace splatrl
