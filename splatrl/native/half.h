// Conversion of half floats, one at a time and by their bits, so that every processor gives the same result.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#include "inline.h"

namespace splatrl {

constexpr float LARGEST_HALF = 65504.0f;
constexpr float HALF_BIAS = 5.192296858534828e33f, INVERSE_HALF_BIAS = 1.925929944387236e-34f;  // 2^112, 2^-112

// Round to the nearest half float; values out of range become the largest finite one, with their sign.
SPLAT_INLINE uint16_t to_half(float value) {
    const float scaled = std::fmin(std::fabs(value), LARGEST_HALF) * INVERSE_HALF_BIAS;
    uint32_t bits;
    std::memcpy(&bits, &scaled, sizeof(bits));
    return uint16_t(((bits + 0xfff + ((bits >> 13) & 1)) >> 13) | (std::signbit(value) ? 0x8000 : 0));
}

SPLAT_INLINE float from_half(uint16_t half) {
    const uint32_t bits = uint32_t(half & 0x7fff) << 13;
    float magnitude;
    std::memcpy(&magnitude, &bits, sizeof(magnitude));
    return std::copysign(magnitude * HALF_BIAS, half & 0x8000 ? -1.0f : 1.0f);
}

}  // namespace splatrl
