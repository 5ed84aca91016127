// Vectors of doubles, as wide as the registers of the instruction set.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#if defined(SPLATRL_AVX512)
#define SPLATRL_DOUBLES 8
#elif defined(SPLATRL_AVX2)
#define SPLATRL_DOUBLES 4
#else
#define SPLATRL_DOUBLES 2
#endif

namespace splatrl {
namespace SPLATRL_ISA {

constexpr int WIDTH = SPLATRL_DOUBLES;

typedef double Part __attribute__((vector_size(8 * SPLATRL_DOUBLES)));
typedef int64_t Mask __attribute__((vector_size(8 * SPLATRL_DOUBLES)));

static inline Part load(const double* from) {
    Part out;
    std::memcpy(&out, __builtin_assume_aligned(from, 64), sizeof(out));
    return out;
}

static inline void store(double* to, const Part& value) {
    std::memcpy(__builtin_assume_aligned(to, 64), &value, sizeof(value));
}

static inline Part root(const Part& a) {
    Part out;
    for (int i = 0; i < WIDTH; ++i) out[i] = std::sqrt(a[i]);
    return out;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
