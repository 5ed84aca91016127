// One step of Adam (Kingma and Ba 2015), and the noise of 3DGS-MCMC (Kheradmand et al. 2024).
#pragma once

#include "fit_kernel.h"
#include "lanes.h"

#ifndef __CUDACC__
#include <cmath>
#endif

namespace splatrl {
namespace SPLATRL_ISA {

LANE_INLINE uint64_t mixed(uint64_t a) {  // splitmix64
    a += 0x9e3779b97f4a7c15ull;
    a = (a ^ (a >> 30)) * 0xbf58476d1ce4e5b9ull;
    a = (a ^ (a >> 27)) * 0x94d049bb133111ebull;
    return a ^ (a >> 31);
}

// A nearly normal random number of variance 1: the scaled sum of four uniform ones.
LANE_INLINE float normal_of(uint64_t bits) {
    const int sum = int(bits & 0xffff) + int(bits >> 16 & 0xffff) + int(bits >> 32 & 0xffff) + int(bits >> 48);
    return (float(sum) - 131070.0f) * (1.7320508f / 65536.0f);
}

LANE_INLINE Lanes regulariser(const FitUpdate& update, size_t row, const Lanes& value) {
    if (row == FIT_LOGIT) {
        const Lanes o = reciprocal(exp2(max(min(value * -1.44269504f, 60.0f), -60.0f)) + 1.0f);
        return update.opacity_slope * (o * (1.0f - o));
    }
    if (row < FIT_LOG_SCALE || row >= FIT_QUAT) return lanes(0.0f);
    return update.scale_slope * exp2(max(min(value * 1.44269504f, 60.0f), -60.0f));
}

LANE_INLINE void adam(const FitUpdate& update, size_t row, size_t at) {
    const size_t place = row * update.stride + at;
    Lanes value = load(update.values + place), gradient = load(update.gradients + place);
    for (size_t view = 1; view < update.views; ++view)
        gradient = gradient + load(update.gradients + view * update.rows * update.stride + place);
    gradient = gradient * (1.0f / float(update.views)) + regulariser(update, row, value);
    const Lanes first = load(update.first_moments + place) * update.beta1 + gradient * (1.0f - update.beta1);
    const Lanes second = load(update.second_moments + place) * update.beta2 +
        gradient * gradient * (1.0f - update.beta2);
    const Lanes squared = max(second * update.correction2, 1e-36f);
    const Lanes root = squared * reciprocal_sqrt(squared);
    value = value - update.rates[row] * update.correction1 * first * reciprocal(root + update.epsilon);
    store(update.values + place, value);
    store(update.first_moments + place, first);
    store(update.second_moments + place, second);
}

// Add noise with the shape of its covariance to the mean of one Gaussian. The weight is larger for fainter ones.
LANE_INLINE void shake(const FitUpdate& update, size_t at, float weight) {
    float* values = update.values + at;
    float q[4], squared = 1e-30f, scale[3], random[3];
    for (int i = 0; i < 4; ++i) q[i] = values[(FIT_QUAT + i) * update.stride], squared += q[i] * q[i];
    const float inverse = 1.0f / sqrtf(squared);
    const float w = q[0] * inverse, x = q[1] * inverse, y = q[2] * inverse, z = q[3] * inverse;
    const float R[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)};
    for (int i = 0; i < 3; ++i) {
        random[i] = normal_of(mixed(update.seed + 3 * at + size_t(i)));
        scale[i] = expf(values[(FIT_LOG_SCALE + i) * update.stride]);
    }
    for (int k = 0; k < 3; ++k) {  // the covariance times the noise
        const float along = R[k] * random[0] + R[3 + k] * random[1] + R[6 + k] * random[2];
        for (int i = 0; i < 3; ++i)
            values[(FIT_MEAN + i) * update.stride] += weight * R[3 * i + k] * scale[k] * scale[k] * along;
    }
}

static void update_all(const FitUpdate& update, size_t first, size_t last) {
    for (size_t row = 0; row < update.rows; ++row)
        for (size_t at = first; at < last; at += LANES) adam(update, row, at);
    if (update.noise <= 0.0f) return;
    for (size_t at = first; at < last; at += LANES) {
        const Lanes logit = load(update.values + FIT_LOGIT * update.stride + at);
        const Lanes opacity = reciprocal(exp2(max(min(logit * -1.44269504f, 60.0f), -60.0f)) + 1.0f);
        alignas(64) float weights[LANES];
        store(weights, reciprocal(exp2(min((opacity - 0.005f) * 144.269504f, 60.0f)) + 1.0f));
        for (int lane = 0; lane < LANES; ++lane)
            if (weights[lane] > 1e-4f) shake(update, at + size_t(lane), update.noise * weights[lane]);
    }
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
