// Activates the parameters of Gaussians and evaluates their colours: sixteen at a time, or one on a GPU.
#pragma once

#include "fit_kernel.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

constexpr float LOG2_E = 1.44269504f;

LANE_INLINE Lanes row_of(const FitModel& model, int row, size_t first) {
    return load(model.values + size_t(row) * model.stride + first);
}

LANE_INLINE Lanes dot(const Lanes* a, const Lanes* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

LANE_INLINE void cross(const Lanes* a, const Lanes* b, Lanes* out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

// The activated parameters of sixteen Gaussians.
struct Activated {
    Vector<Lanes> offset;  // mean relative to the camera, world axes
    Lanes quat[4], inverse_norm;
    Lanes rotation[9], scales[3], axes[9];
    Lanes opacity, log2_opacity;
};

LANE_INLINE void rotation_of(const Lanes* q, Lanes* out) {
    const Lanes &w = q[0], &x = q[1], &y = q[2], &z = q[3];
    out[0] = 1.0f - 2.0f * (y * y + z * z), out[1] = 2.0f * (x * y - w * z), out[2] = 2.0f * (x * z + w * y);
    out[3] = 2.0f * (x * y + w * z), out[4] = 1.0f - 2.0f * (x * x + z * z), out[5] = 2.0f * (y * z - w * x);
    out[6] = 2.0f * (x * z - w * y), out[7] = 2.0f * (y * z + w * x), out[8] = 1.0f - 2.0f * (x * x + y * y);
}

LANE_INLINE Activated activate(const FitModel& model, const Camera& camera, size_t first) {
    Activated out;
    out.offset = {row_of(model, FIT_MEAN, first) - camera.position[0],
                  row_of(model, FIT_MEAN + 1, first) - camera.position[1],
                  row_of(model, FIT_MEAN + 2, first) - camera.position[2]};
    Lanes squared = lanes(0.0f);
    for (int i = 0; i < 4; ++i) {
        out.quat[i] = row_of(model, FIT_QUAT + i, first);
        squared = squared + out.quat[i] * out.quat[i];
    }
    out.inverse_norm = reciprocal_sqrt(max(squared, 1e-30f));
    for (int i = 0; i < 4; ++i) out.quat[i] = out.quat[i] * out.inverse_norm;
    rotation_of(out.quat, out.rotation);
    for (int axis = 0; axis < 3; ++axis) {
        out.scales[axis] = exp2(max(min(row_of(model, FIT_LOG_SCALE + axis, first) * LOG2_E, 60.0f), -60.0f));
        for (int i = 0; i < 3; ++i) out.axes[3 * i + axis] = out.rotation[3 * i + axis] * out.scales[axis];
    }
    const Lanes odds = exp2(max(min(row_of(model, FIT_LOGIT, first) * -LOG2_E, 60.0f), -60.0f)) + 1.0f;
    out.opacity = reciprocal(odds);
    out.log2_opacity = -log2(odds);
    return out;
}

LANE_INLINE Lanes inverse_length(const Vector<Lanes>& a) {
    return reciprocal_sqrt(max(a.x * a.x + a.y * a.y + a.z * a.z, 1e-30f));
}

// Evaluate the colours before they are clamped at 0.
LANE_INLINE void raw_colors(const FitModel& model, size_t first, const Lanes* basis, Lanes* rgb) {
    const int harmonics = (model.degree + 1) * (model.degree + 1);
    for (int channel = 0; channel < 3; ++channel) {
        rgb[channel] = lanes(0.5f);
        for (int i = 0; i < harmonics; ++i)
            rgb[channel] = rgb[channel] + basis[i] * row_of(model, FIT_SH + 3 * i + channel, first);
    }
}

LANE_INLINE void basis_of(const FitModel& model, const Vector<Lanes>& offset, Lanes inverse, Lanes* basis) {
    sh_basis(model.degree, offset.x * inverse, offset.y * inverse, offset.z * inverse, basis);
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
