// Sixteen floats as one value, in as many registers as the instruction set needs. Nearly all of it uses the vector
// extensions of GCC and Clang, which work on any processor; some of what they lack or do slowly uses intrinsics of
// AVX-512, AVX2 or ARM. Everything lives in the namespace of the instruction set, so that the linker never mixes
// variants.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

#if defined(SPLATRL_AVX512) || defined(SPLATRL_AVX2)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

#if defined(SPLATRL_AVX512)
#define SPLATRL_REGISTER 16
#elif defined(SPLATRL_AVX2)
#define SPLATRL_REGISTER 8
#else
#define SPLATRL_REGISTER 4
#endif

namespace splatrl {
namespace SPLATRL_ISA {

#define LANE_INLINE static inline __attribute__((always_inline))
#define OUT_OF_LINE __attribute__((noinline))  // keeps long loops from competing for registers

constexpr int LANES = 16;
constexpr int PARTS = LANES / SPLATRL_REGISTER;

typedef float FloatPart __attribute__((vector_size(4 * SPLATRL_REGISTER)));
typedef int32_t IntPart __attribute__((vector_size(4 * SPLATRL_REGISTER)));
typedef uint32_t UnsignedPart __attribute__((vector_size(4 * SPLATRL_REGISTER)));

// COUNT registers of floats.
template <int COUNT>
struct FloatLanes {
    FloatPart part[COUNT];
};

using Lanes = FloatLanes<PARTS>;

struct IntLanes {
    IntPart part[PARTS];
};

#define FOR_PARTS for (int p = 0; p < PARTS; ++p)
#define FOR_PARTS_OF(count) for (int p = 0; p < count; ++p)

LANE_INLINE FloatPart splat_part(float value) { return value - FloatPart{}; }

LANE_INLINE Lanes lanes(float value) {
    Lanes out;
    FOR_PARTS out.part[p] = splat_part(value);
    return out;
}

// Load sixteen floats; `from` is aligned to 64 bytes.
LANE_INLINE Lanes load(const float* from) {
    Lanes out;
    std::memcpy(&out, __builtin_assume_aligned(from, 64), sizeof(out));
    return out;
}

// Store sixteen floats; `to` is aligned to 64 bytes.
LANE_INLINE void store(float* to, const Lanes& value) {
    std::memcpy(__builtin_assume_aligned(to, 64), &value, sizeof(value));
}

// Concatenate the items of an array of lanes.
template <size_t COUNT>
LANE_INLINE FloatLanes<int(COUNT) * PARTS> joined(const Lanes (&from)[COUNT]) {
    FloatLanes<int(COUNT) * PARTS> out;
    FOR_PARTS_OF(int(COUNT) * PARTS) out.part[p] = from[p / PARTS].part[p % PARTS];
    return out;
}

// Concatenate one member of each item of an array.
template <class T, size_t COUNT>
LANE_INLINE FloatLanes<int(COUNT) * PARTS> joined(const T (&from)[COUNT], Lanes T::*number) {
    FloatLanes<int(COUNT) * PARTS> out;
    FOR_PARTS_OF(int(COUNT) * PARTS) out.part[p] = (from[p / PARTS].*number).part[p % PARTS];
    return out;
}

// The i-th item of what was concatenated.
template <int COUNT>
LANE_INLINE Lanes lanes_of(const FloatLanes<COUNT>& from, uint32_t i) {
    Lanes out;
    FOR_PARTS out.part[p] = from.part[int(i) * PARTS + p];
    return out;
}

#define LANE_OPERATOR(op)                                                                                 \
    template <int COUNT>                                                                                  \
    LANE_INLINE FloatLanes<COUNT> operator op(const FloatLanes<COUNT>& a, const FloatLanes<COUNT>& b) {   \
        FloatLanes<COUNT> out;                                                                            \
        FOR_PARTS_OF(COUNT) out.part[p] = a.part[p] op b.part[p];                                         \
        return out;                                                                                       \
    }                                                                                                     \
    template <int COUNT>                                                                                  \
    LANE_INLINE FloatLanes<COUNT> operator op(const FloatLanes<COUNT>& a, float b) {                      \
        FloatLanes<COUNT> out;                                                                            \
        FOR_PARTS_OF(COUNT) out.part[p] = a.part[p] op b;                                                 \
        return out;                                                                                       \
    }                                                                                                     \
    template <int COUNT>                                                                                  \
    LANE_INLINE FloatLanes<COUNT> operator op(float a, const FloatLanes<COUNT>& b) {                      \
        FloatLanes<COUNT> out;                                                                            \
        FOR_PARTS_OF(COUNT) out.part[p] = a op b.part[p];                                                 \
        return out;                                                                                       \
    }
LANE_OPERATOR(+)
LANE_OPERATOR(-)
LANE_OPERATOR(*)
LANE_OPERATOR(/)
#undef LANE_OPERATOR

template <int COUNT>
LANE_INLINE FloatLanes<COUNT> operator-(const FloatLanes<COUNT>& a) {
    FloatLanes<COUNT> out;
    FOR_PARTS_OF(COUNT) out.part[p] = -a.part[p];
    return out;
}

template <int COUNT>
LANE_INLINE FloatLanes<COUNT> min(const FloatLanes<COUNT>& a, const FloatLanes<COUNT>& b) {
    FloatLanes<COUNT> out;
    FOR_PARTS_OF(COUNT) {
#if defined(SPLATRL_AVX512)
        out.part[p] = (FloatPart)_mm512_maskz_min_ps(0xffff, (__m512)a.part[p], (__m512)b.part[p]);
#else
        out.part[p] = a.part[p] < b.part[p] ? a.part[p] : b.part[p];
#endif
    }
    return out;
}

template <int COUNT>
LANE_INLINE FloatLanes<COUNT> max(const FloatLanes<COUNT>& a, const FloatLanes<COUNT>& b) {
    FloatLanes<COUNT> out;
    FOR_PARTS_OF(COUNT) {
#if defined(SPLATRL_AVX512)
        out.part[p] = (FloatPart)_mm512_maskz_max_ps(0xffff, (__m512)a.part[p], (__m512)b.part[p]);
#else
        out.part[p] = a.part[p] > b.part[p] ? a.part[p] : b.part[p];
#endif
    }
    return out;
}

template <int COUNT>
LANE_INLINE FloatLanes<COUNT> min(const FloatLanes<COUNT>& a, float b) {
    FloatLanes<COUNT> all;
    FOR_PARTS_OF(COUNT) all.part[p] = splat_part(b);
    return min(a, all);
}

template <int COUNT>
LANE_INLINE FloatLanes<COUNT> max(const FloatLanes<COUNT>& a, float b) {
    FloatLanes<COUNT> all;
    FOR_PARTS_OF(COUNT) all.part[p] = splat_part(b);
    return max(a, all);
}

// `value` where `tested` >= `bound`, else 0.
LANE_INLINE Lanes select_if_at_least(const Lanes& tested, float bound, const Lanes& value) {
    Lanes out;
    const FloatPart limit = splat_part(bound);
    FOR_PARTS out.part[p] = tested.part[p] >= limit ? value.part[p] : FloatPart{};
    return out;
}

#if defined(SPLATRL_AVX512)
typedef __mmask16 LaneMask;
#else
typedef IntLanes LaneMask;
#endif

LANE_INLINE LaneMask above(const Lanes& a, float bound) {
#if defined(SPLATRL_AVX512)
    return _mm512_cmp_ps_mask((__m512)a.part[0], _mm512_set1_ps(bound), _CMP_GT_OQ);
#else
    LaneMask out;
    FOR_PARTS out.part[p] = a.part[p] > splat_part(bound);
    return out;
#endif
}

LANE_INLINE LaneMask all_lanes() {
#if defined(SPLATRL_AVX512)
    return 0xffff;
#else
    LaneMask out;
    FOR_PARTS out.part[p] = ~IntPart{};
    return out;
#endif
}

// a + b · c where the mask is set, else a.
LANE_INLINE Lanes add_product_where(const LaneMask& mask, const Lanes& a, const Lanes& b, float c) {
    Lanes out;
#if defined(SPLATRL_AVX512)
    out.part[0] = (FloatPart)_mm512_mask3_fmadd_ps((__m512)b.part[0], _mm512_set1_ps(c), (__m512)a.part[0], mask);
#else
    FOR_PARTS out.part[p] = a.part[p] + (FloatPart)((IntPart)b.part[p] & mask.part[p]) * c;
#endif
    return out;
}

// A mask whose bit i is set if lane i of `a` > lane i of `b`.
LANE_INLINE uint32_t bits_above(const Lanes& a, const Lanes& b) {
#if defined(SPLATRL_AVX512)
    return _mm512_cmp_ps_mask((__m512)a.part[0], (__m512)b.part[0], _CMP_GT_OQ);
#elif defined(SPLATRL_AVX2)
    return uint32_t(_mm256_movemask_ps(_mm256_cmp_ps((__m256)a.part[0], (__m256)b.part[0], _CMP_GT_OQ))) |
           uint32_t(_mm256_movemask_ps(_mm256_cmp_ps((__m256)a.part[1], (__m256)b.part[1], _CMP_GT_OQ))) << 8;
#else
    constexpr UnsignedPart FIRST{1, 2, 4, 8};
    UnsignedPart bits{};
    FOR_PARTS bits |= (UnsignedPart)(a.part[p] > b.part[p]) & (FIRST << (4 * p));
    return bits[0] | bits[1] | bits[2] | bits[3];
#endif
}

// Always true: the sixteen Gaussians of a vector are all merged, or MERGED is false and this is not called.
template <int COUNT>
LANE_INLINE bool stand_for_many(const FloatLanes<COUNT>&) {
    return true;
}

// 1 / a to the last bit or two, for normal a > 0: on AVX-512, an estimate and one step of Newton's method.
template <int COUNT>
LANE_INLINE FloatLanes<COUNT> reciprocal(const FloatLanes<COUNT>& a) {
    FloatLanes<COUNT> out;
#if defined(SPLATRL_AVX512)
    FOR_PARTS_OF(COUNT) {
        const FloatPart r = (FloatPart)_mm512_maskz_rcp14_ps(0xffff, (__m512)a.part[p]);
        out.part[p] = r * (2.0f - a.part[p] * r);
    }
#else
    FOR_PARTS_OF(COUNT) out.part[p] = 1.0f / a.part[p];
#endif
    return out;
}

// 1 / sqrt(a) to the last bit or two, for normal a > 0: an estimate and one step of Newton's method.
template <int COUNT>
LANE_INLINE FloatLanes<COUNT> reciprocal_sqrt(const FloatLanes<COUNT>& a) {
    FloatLanes<COUNT> out;
    FOR_PARTS_OF(COUNT) {
#if defined(SPLATRL_AVX512)
        const FloatPart r = (FloatPart)_mm512_maskz_rsqrt14_ps(0xffff, (__m512)a.part[p]);
#elif defined(SPLATRL_AVX2)
        const FloatPart r = (FloatPart)_mm256_rsqrt_ps((__m256)a.part[p]);
#elif defined(__aarch64__)
        const float32x4_t x = (float32x4_t)a.part[p], estimate = vrsqrteq_f32(x);  // 8 bits only, hence another step
        const FloatPart r = (FloatPart)(estimate * vrsqrtsq_f32(x * estimate, estimate));
#else
        FloatPart r;
        for (int i = 0; i < SPLATRL_REGISTER; ++i) r[i] = 1.0f / __builtin_sqrtf(a.part[p][i]);
#endif
        out.part[p] = r * (1.5f - 0.5f * a.part[p] * r * r);
    }
    return out;
}

// The largest integer <= a, for a in [0, 2^31).
template <int COUNT>
LANE_INLINE FloatLanes<COUNT> floor(const FloatLanes<COUNT>& a) {
    FloatLanes<COUNT> out;
    FOR_PARTS_OF(COUNT) out.part[p] = __builtin_convertvector(__builtin_convertvector(a.part[p], IntPart), FloatPart);
    return out;
}

// The smallest integer >= a, for a in [0, 2^31).
template <int COUNT>
LANE_INLINE FloatLanes<COUNT> ceil(const FloatLanes<COUNT>& a) {
    FloatLanes<COUNT> out = floor(a);
    FOR_PARTS_OF(COUNT) out.part[p] += a.part[p] > out.part[p] ? splat_part(1.0f) : FloatPart{};
    return out;
}

// 2^a for a in [-126, 126], arbitrary outside, with a relative error of 3e-6: 2^(a - round(a)) by a polynomial, to
// which the exponent is added.
template <int COUNT>
LANE_INLINE FloatLanes<COUNT> exp2(const FloatLanes<COUNT>& a) {
    constexpr float ROUND = 12582912.0f;  // 1.5 · 2^23: adding it rounds to an integer in the lowest bits
    FloatLanes<COUNT> out;
    FOR_PARTS_OF(COUNT) {
        const FloatPart shifted = a.part[p] + ROUND;
        const FloatPart f = a.part[p] - (shifted - ROUND);
        const FloatPart power =
            (((9.5701013e-3f * f + 5.5917879e-2f) * f + 2.4024744e-1f) * f + 6.9312179e-1f) * f + 9.9999928e-1f;
        out.part[p] = (FloatPart)((UnsignedPart)power + ((UnsignedPart)shifted << 23));  // wraps outside the range
    }
    return out;
}

// 2^a where a >= bound, else 0. With AVX-512 this takes only five operations and has a relative error of 8e-5, because
// blending is limited by arithmetic.
LANE_INLINE Lanes exp2_if_at_least(const Lanes& a, float bound) {
#if defined(SPLATRL_AVX512)
    const __m512 value = (__m512)a.part[0];
    const __mmask16 large = _mm512_cmp_ps_mask(value, _mm512_set1_ps(bound), _CMP_GE_OQ);
    const FloatPart f = (FloatPart)_mm512_maskz_reduce_ps(0xffff, value, _MM_FROUND_TO_NEG_INF);  // a - floor(a)
    const FloatPart power = ((7.8024523e-2f * f + 2.2606716e-1f) * f + 6.9583354e-1f) * f + 9.9992522e-1f;
    Lanes out;
    out.part[0] = (FloatPart)_mm512_maskz_scalef_ps(large, (__m512)power, value);
    return out;
#else
    return select_if_at_least(a, bound, exp2(a));
#endif
}

// log2(a) for normal a > 0, with an absolute error of 1e-7 plus rounding: exponent plus atanh series of the mantissa.
template <int COUNT>
LANE_INLINE FloatLanes<COUNT> log2(const FloatLanes<COUNT>& a) {
    FloatLanes<COUNT> above, below, whole;
    FOR_PARTS_OF(COUNT) {
        const IntPart bits = (IntPart)a.part[p];
        const IntPart exponent = (bits - 0x3f3504f3) >> 23;  // the mantissa is in [√½, √2)
        const FloatPart mantissa = (FloatPart)(bits - (exponent << 23));
        above.part[p] = mantissa - 1.0f;
        below.part[p] = mantissa + 1.0f;
        whole.part[p] = __builtin_convertvector(exponent, FloatPart);
    }
    const FloatLanes<COUNT> s = above * reciprocal(below), q = s * s;
    return ((((0.32059889f * q + 0.41219858f) * q + 0.57707802f) * q + 0.96179669f) * q + 2.88539008f) * s + whole;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
