// The functions that splat.h needs, for one float; lanes.h has them for sixteen. On a GPU they are single instructions
// of the hardware, with errors of a few units in the last place.
#pragma once

#include "inline.h"

#ifndef __CUDACC__
#include <cmath>
#endif

namespace splatrl {

SPLAT_INLINE float select_if_at_least(float tested, float bound, float value) { return tested >= bound ? value : 0.0f; }

// Whether a Gaussian with this count of members is a merged one.
SPLAT_INLINE bool stand_for_many(float members) { return members > 0.0f; }

#ifdef __CUDA_ARCH__

SPLAT_INLINE float min(float a, float b) { return fminf(a, b); }
SPLAT_INLINE float max(float a, float b) { return fmaxf(a, b); }

HARDWARE(reciprocal, "rcp.approx.ftz.f32 %0, %1;")
HARDWARE(reciprocal_sqrt, "rsqrt.approx.ftz.f32 %0, %1;")
HARDWARE(square_root, "sqrt.approx.ftz.f32 %0, %1;")
HARDWARE(log2, "lg2.approx.ftz.f32 %0, %1;")
HARDWARE(exp2, "ex2.approx.ftz.f32 %0, %1;")

#else

SPLAT_INLINE float min(float a, float b) { return a < b ? a : b; }
SPLAT_INLINE float max(float a, float b) { return a > b ? a : b; }
SPLAT_INLINE float reciprocal(float a) { return 1.0f / a; }
SPLAT_INLINE float reciprocal_sqrt(float a) { return 1.0f / std::sqrt(a); }
SPLAT_INLINE float square_root(float a) { return std::sqrt(a); }
SPLAT_INLINE float log2(float a) { return std::log2(a); }
SPLAT_INLINE float exp2(float a) { return std::exp2(a); }

#endif

SPLAT_INLINE float exp2_if_at_least(float a, float bound) { return select_if_at_least(a, bound, exp2(a)); }

}  // namespace splatrl
