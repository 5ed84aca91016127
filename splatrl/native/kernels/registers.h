// A single register of floats, for kernels whose vectors need not have sixteen lanes.
#pragma once

#include <cstring>

#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

// One register; a vector of sixteen lanes may take several.
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
