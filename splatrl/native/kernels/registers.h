// Floats in one register, for kernels whose vectors need not be of sixteen.
#pragma once

#include <cstring>

#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

// One register, of which a vector of sixteen may need several.
using Register = FloatPart;
constexpr int WIDTH = SPLATRL_REGISTER;

LANE_INLINE Register get(const float* from) {
    Register out;
    std::memcpy(&out, from, sizeof(out));
    return out;
}

LANE_INLINE void put(float* to, const Register& value) { std::memcpy(to, &value, sizeof(value)); }

LANE_INLINE float total(const Register& a) {
    float values[WIDTH];
    put(values, a);
    for (int half = WIDTH / 2; half > 0; half /= 2)
        for (int i = 0; i < half; ++i) values[i] += values[i + half];
    return values[0];
}

LANE_INLINE Register positive(const Register& a) { return a > Register{} ? a : Register{}; }

}  // namespace SPLATRL_ISA
}  // namespace splatrl
