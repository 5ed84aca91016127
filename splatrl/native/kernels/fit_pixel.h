// Evaluates a splat at a pixel, and its backward pass: sixteen pixels at a time, or one on a GPU.
#pragma once

#include "fit_kernel.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

constexpr float LOG2_MAX_ALPHA = -0.00144341686f;

LANE_INLINE Lanes exponent_at(const FitSplat& splat, const Lanes& dx, const Lanes& dy) {
    const Lanes u = dx * splat.l11 + dy * splat.l12, v = dy * splat.l22;
    return splat.log2_opacity - u * u - v * v;
}

LANE_INLINE Lanes alpha_of(const Lanes& exponent) {
    return select_if_at_least(exponent, LOG2_INVISIBLE_ANTIALIASED, min(exp2(exponent), MAX_ALPHA));
}

// Agreement of a depth with known depths, which are given by their inverses: 1 where they are equal, falling linearly
// to 0 at a relative error of 1.
LANE_INLINE Lanes agreement(float depth, const Lanes& known) {
    const Lanes away = known * depth - 1.0f;
    return max(1.0f - max(away, -away), 0.0f);
}

// The state that pixels carry through the backward pass, from front to back: `total` is the dot product of a pixel's
// gradient and its value, `before` the part of it that the splats so far account for.
struct FitBehind {
    Lanes slopes[FIT_CHANNELS], known, total, before, transmittance;
};

// Compute v = dL / d ln(alpha) of one splat at the pixels and its blending weight, and advance `behind` past the splat.
template <bool KNOWN>
LANE_INLINE void step_back(const FitSplat& splat, const Lanes& x, const Lanes& y, FitBehind& behind, Lanes& v,
                           Lanes& share) {
    const Lanes exponent = exponent_at(splat, x - splat.x, y - splat.y);
    const Lanes alpha = alpha_of(exponent);
    const Lanes let_through = behind.transmittance * alpha;
    behind.transmittance = behind.transmittance - let_through;
    share = select_if_at_least(behind.transmittance, MIN_TRANSMITTANCE, let_through);
    Lanes worth = behind.slopes[F_RED] * splat.red + behind.slopes[F_GREEN] * splat.green +
                  behind.slopes[F_BLUE] * splat.blue + behind.slopes[F_ALPHA];
    if (KNOWN) worth = worth + behind.slopes[F_AGREEMENT] * agreement(splat.depth, behind.known);
    const Lanes gain = share * worth;
    behind.before = behind.before + gain;
    const Lanes hidden = (behind.total - behind.before) * alpha * reciprocal(1.0f - alpha);
    const Lanes slope = select_if_at_least(behind.transmittance, MIN_TRANSMITTANCE, gain - hidden);
    v = select_if_at_least(-exponent, -LOG2_MAX_ALPHA, slope);
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
