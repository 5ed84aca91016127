// Sixteen floats as one value, in as many registers as the instruction set needs. GCC and Clang vector extensions:
// the same source runs on x86 and ARM. Everything lives in the namespace of the instruction set, so that the linker
// never mixes variants.
#pragma once

#include <cstdint>
#include <cstring>

#if defined(__AVX512F__)
#include <immintrin.h>
#define SPLATRL_REGISTER 16
#elif defined(__AVX__)
#include <immintrin.h>
#define SPLATRL_REGISTER 8
#else
#define SPLATRL_REGISTER 4
#endif

namespace splatrl {
namespace SPLATRL_ISA {

#define LANE_INLINE static inline __attribute__((always_inline))

constexpr int LANES = 16;
constexpr int PARTS = LANES / SPLATRL_REGISTER;

typedef float FloatPart __attribute__((vector_size(4 * SPLATRL_REGISTER)));
typedef int32_t IntPart __attribute__((vector_size(4 * SPLATRL_REGISTER)));

struct Lanes {
    FloatPart part[PARTS];
};

#define FOR_PARTS for (int p = 0; p < PARTS; ++p)

LANE_INLINE FloatPart splat_part(float value) { return value - FloatPart{}; }

LANE_INLINE Lanes lanes(float value) {
    Lanes out;
    FOR_PARTS out.part[p] = splat_part(value);
    return out;
}

// `from` and `to` are aligned to 64 bytes.
LANE_INLINE Lanes load(const float* from) {
    Lanes out;
    std::memcpy(&out, __builtin_assume_aligned(from, 64), sizeof(out));
    return out;
}

LANE_INLINE void store(float* to, const Lanes& value) {
    std::memcpy(__builtin_assume_aligned(to, 64), &value, sizeof(value));
}

#define LANE_OPERATOR(op)                                                                                 \
    LANE_INLINE Lanes operator op(const Lanes& a, const Lanes& b) {                                       \
        Lanes out;                                                                                        \
        FOR_PARTS out.part[p] = a.part[p] op b.part[p];                                                   \
        return out;                                                                                       \
    }                                                                                                     \
    LANE_INLINE Lanes operator op(const Lanes& a, float b) {                                              \
        Lanes out;                                                                                        \
        FOR_PARTS out.part[p] = a.part[p] op b;                                                           \
        return out;                                                                                       \
    }                                                                                                     \
    LANE_INLINE Lanes operator op(float a, const Lanes& b) {                                              \
        Lanes out;                                                                                        \
        FOR_PARTS out.part[p] = a op b.part[p];                                                           \
        return out;                                                                                       \
    }
LANE_OPERATOR(+)
LANE_OPERATOR(-)
LANE_OPERATOR(*)
LANE_OPERATOR(/)
#undef LANE_OPERATOR

LANE_INLINE Lanes operator-(const Lanes& a) {
    Lanes out;
    FOR_PARTS out.part[p] = -a.part[p];
    return out;
}

LANE_INLINE Lanes min(const Lanes& a, float b) {
    Lanes out;
    const FloatPart bound = splat_part(b);
#if defined(__AVX512F__)
    out.part[0] = (FloatPart)_mm512_maskz_min_ps(0xffff, (__m512)a.part[0], (__m512)bound);
#else
    FOR_PARTS out.part[p] = a.part[p] < bound ? a.part[p] : bound;
#endif
    return out;
}

LANE_INLINE Lanes max(const Lanes& a, float b) {
    Lanes out;
    const FloatPart bound = splat_part(b);
#if defined(__AVX512F__)
    out.part[0] = (FloatPart)_mm512_maskz_max_ps(0xffff, (__m512)a.part[0], (__m512)bound);
#else
    FOR_PARTS out.part[p] = a.part[p] > bound ? a.part[p] : bound;
#endif
    return out;
}

// `value` where `tested` >= `bound`, else 0.
LANE_INLINE Lanes select_if_at_least(const Lanes& tested, float bound, const Lanes& value) {
    Lanes out;
    const FloatPart limit = splat_part(bound);
    FOR_PARTS out.part[p] = tested.part[p] >= limit ? value.part[p] : FloatPart{};
    return out;
}

// `value` where `tested` > `bound`, else 0.
LANE_INLINE Lanes select_if_above(const Lanes& tested, float bound, const Lanes& value) {
    Lanes out;
    const FloatPart limit = splat_part(bound);
    FOR_PARTS out.part[p] = tested.part[p] > limit ? value.part[p] : FloatPart{};
    return out;
}

// Bit i is set where lane i of `a` > lane i of `b`.
LANE_INLINE uint32_t bits_above(const Lanes& a, const Lanes& b) {
#if defined(__AVX512F__)
    return _mm512_cmp_ps_mask((__m512)a.part[0], (__m512)b.part[0], _CMP_GT_OQ);
#elif defined(__AVX__)
    return uint32_t(_mm256_movemask_ps(_mm256_cmp_ps((__m256)a.part[0], (__m256)b.part[0], _CMP_GT_OQ))) |
           uint32_t(_mm256_movemask_ps(_mm256_cmp_ps((__m256)a.part[1], (__m256)b.part[1], _CMP_GT_OQ))) << 8;
#else
    uint32_t bits = 0;
    for (int i = 0; i < LANES; ++i) bits |= uint32_t(a.part[i / 4][i % 4] > b.part[i / 4][i % 4]) << i;
    return bits;
#endif
}

LANE_INLINE Lanes sqrt(const Lanes& a) {
    Lanes out;
#if defined(__AVX512F__)
    out.part[0] = (FloatPart)_mm512_maskz_sqrt_ps(0xffff, (__m512)a.part[0]);
#elif defined(__AVX__)
    FOR_PARTS out.part[p] = (FloatPart)_mm256_sqrt_ps((__m256)a.part[p]);
#else
    FOR_PARTS for (int i = 0; i < SPLATRL_REGISTER; ++i) out.part[p][i] = __builtin_sqrtf(a.part[p][i]);
#endif
    return out;
}

// The largest integer <= a, for a in [0, 2^31).
LANE_INLINE Lanes floor(const Lanes& a) {
    Lanes out;
    FOR_PARTS out.part[p] = __builtin_convertvector(__builtin_convertvector(a.part[p], IntPart), FloatPart);
    return out;
}

typedef float Quad __attribute__((vector_size(16)));
typedef int32_t QuadIndex __attribute__((vector_size(16)));

LANE_INLINE Quad pick(const Quad& a, const Quad& b, const QuadIndex& from) {
#if defined(__clang__)
    Quad out;
    for (int i = 0; i < 4; ++i) out[i] = from[i] < 4 ? a[from[i]] : b[from[i] - 4];
    return out;
#else
    return __builtin_shuffle(a, b, from);
#endif
}

// rows[lane][column] = columns[column][lane], four by four.
template <int COLUMNS>
LANE_INLINE void transpose(const Lanes (&columns)[COLUMNS], float (*rows)[COLUMNS]) {
    static_assert(COLUMNS % 4 == 0, "whole quads");
    for (int column = 0; column < COLUMNS; column += 4)
        for (int lane = 0; lane < LANES; lane += 4) {
            Quad in[4];
            for (int i = 0; i < 4; ++i)
                std::memcpy(&in[i], reinterpret_cast<const float*>(&columns[column + i]) + lane, sizeof(Quad));
            constexpr QuadIndex LOW{0, 4, 1, 5}, HIGH{2, 6, 3, 7}, FIRST{0, 1, 4, 5}, SECOND{2, 3, 6, 7};
            const Quad low_ab = pick(in[0], in[1], LOW), low_cd = pick(in[2], in[3], LOW);
            const Quad high_ab = pick(in[0], in[1], HIGH), high_cd = pick(in[2], in[3], HIGH);
            const Quad out[4] = {pick(low_ab, low_cd, FIRST), pick(low_ab, low_cd, SECOND),
                                 pick(high_ab, high_cd, FIRST), pick(high_ab, high_cd, SECOND)};
            for (int i = 0; i < 4; ++i) std::memcpy(&rows[lane + i][column], &out[i], sizeof(Quad));
        }
}

// 2^a for a in [-126, 126], anything beyond, relative error 2e-7: 2^(a - round(a)) by a polynomial, then the exponent.
LANE_INLINE Lanes exp2(const Lanes& a) {
    constexpr float ROUND = 12582912.0f;  // 1.5 · 2^23: adding it rounds to an integer in the lowest bits
    Lanes out;
    FOR_PARTS {
        const FloatPart shifted = a.part[p] + ROUND;
        const FloatPart f = a.part[p] - (shifted - ROUND);
        const FloatPart power =
            ((((1.3333558e-3f * f + 9.6181291e-3f) * f + 5.5504109e-2f) * f + 2.4022651e-1f) * f + 6.9314718e-1f) * f +
            1.0f;
        out.part[p] = (FloatPart)((IntPart)power + ((IntPart)shifted << 23));
    }
    return out;
}

// log2(a) for normal a > 0, absolute error 1e-7 plus rounding: exponent, and the atanh series of the mantissa.
LANE_INLINE Lanes log2(const Lanes& a) {
    Lanes out;
    FOR_PARTS {
        const IntPart bits = (IntPart)a.part[p];
        const IntPart exponent = (bits - 0x3f3504f3) >> 23;  // the mantissa is in [√½, √2)
        const FloatPart mantissa = (FloatPart)(bits - (exponent << 23));
        const FloatPart s = (mantissa - 1.0f) / (mantissa + 1.0f);
        const FloatPart q = s * s;
        const FloatPart series =
            (((0.32059889f * q + 0.41219858f) * q + 0.57707802f) * q + 0.96179669f) * q + 2.88539008f;
        out.part[p] = series * s + __builtin_convertvector(exponent, FloatPart);
    }
    return out;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
