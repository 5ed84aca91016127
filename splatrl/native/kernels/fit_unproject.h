// Backward pass of the projection: from the moments of splats to the gradients of parameters.
//
// Let M = J R A, so that the covariance on the image is M Mᵀ + 0.3 I; let Q be its inverse, and W the second moments of
// v = dL / d ln(alpha) about the mean. Then dL/dM = (Q W Q - Σv Q) M + Σv d(½ ln det M Mᵀ)/dM.
#pragma once

#include "fit_kernel.h"
#include "kernels/fit_project.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Gradient with respect to a splat's shape: the two rows of M.
struct ShapeSlopes {
    Lanes x[3], y[3];
};

LANE_INLINE ShapeSlopes shape_slopes(const Lanes* jx, const Lanes* jy, const Lanes* moments, Lanes* conic) {
    const Lanes xx = dot(jx, jx) + DILATION, yy = dot(jy, jy) + DILATION, xy = dot(jx, jy);
    Lanes normal[3], turned_x[3], turned_y[3];
    cross(jx, jy, normal);
    cross(jy, normal, turned_x);
    cross(normal, jx, turned_y);
    const Lanes bare = dot(normal, normal);
    const Lanes determinant = bare + (xx + yy - 2.0f * DILATION) * DILATION + DILATION * DILATION;
    const Lanes inverse = reciprocal(determinant);
    const Lanes a = yy * inverse, b = -(xy * inverse), c = xx * inverse;
    conic[0] = a, conic[1] = b, conic[2] = c;
    const Lanes &v = moments[M_V], &vxx = moments[M_VXX], &vxy = moments[M_VXY], &vyy = moments[M_VYY];
    const Lanes p00 = a * vxx + b * vxy, p01 = a * vxy + b * vyy, p10 = b * vxx + c * vxy, p11 = b * vxy + c * vyy;
    const Lanes h00 = p00 * a + p01 * b - v * a, h01 = p00 * b + p01 * c - v * b, h11 = p10 * b + p11 * c - v * c;
    const Lanes thin = select_if_at_least(bare * inverse, 1e-12f, v * reciprocal(max(bare, 1e-30f)));
    ShapeSlopes out;
    for (int k = 0; k < 3; ++k) {
        out.x[k] = h00 * jx[k] + h01 * jy[k] + thin * turned_x[k];
        out.y[k] = h01 * jx[k] + h11 * jy[k] + thin * turned_y[k];
    }
    return out;
}

// dL/dq of a quaternion from dL/dR. It is made perpendicular to the quaternion, whose length has no effect once it is
// normalised.
LANE_INLINE void quat_slopes(const Activated& at, const Lanes* g, Lanes* out) {
    const Lanes &w = at.quat[0], &x = at.quat[1], &y = at.quat[2], &z = at.quat[3];
    const Lanes a = g[7] - g[5], b = g[2] - g[6], c = g[3] - g[1];
    const Lanes d = g[1] + g[3], e = g[2] + g[6], f = g[5] + g[7];
    const Lanes raw[4] = {2.0f * (x * a + y * b + z * c),
                          2.0f * (-2.0f * (x * (g[4] + g[8])) + y * d + z * e + w * a),
                          2.0f * (x * d - 2.0f * (y * (g[0] + g[8])) + z * f + w * b),
                          2.0f * (x * e + y * f - 2.0f * (z * (g[0] + g[4])) + w * c)};
    const Lanes along = w * raw[0] + x * raw[1] + y * raw[2] + z * raw[3];
    for (int i = 0; i < 4; ++i) out[i] = (raw[i] - at.quat[i] * along) * at.inverse_norm;
}

// Write the gradients of the harmonics, and add to `mean` what comes through the viewing direction, which depends on
// it.
LANE_INLINE void color_slopes(const FitModel& model, const Activated& at, size_t first, const Lanes* moments,
                              Lanes* mean, float* out) {
    const Lanes inverse = inverse_length(at.offset);
    Lanes basis[FIT_HARMONICS], rgb[3], by_color[3];
    basis_of(model, at.offset, inverse, basis);
    raw_colors(model, first, basis, rgb);
    for (int c = 0; c < 3; ++c) by_color[c] = select_if_at_least(rgb[c], 1e-30f, moments[M_RED + c]);
    const int harmonics = (model.degree + 1) * (model.degree + 1);
    for (int i = 0; i < harmonics; ++i)
        for (int c = 0; c < 3; ++c)
            store(out + size_t(FIT_SH + 3 * i + c) * model.stride + first, basis[i] * by_color[c]);
    if (model.degree < 1) return;
    Lanes weights[FIT_HARMONICS], slope[3];
    weights[0] = lanes(0.0f);
    for (int i = 1; i < harmonics; ++i) {
        weights[i] = lanes(0.0f);
        for (int c = 0; c < 3; ++c)
            weights[i] = weights[i] + row_of(model, FIT_SH + 3 * i + c, first) * by_color[c];
    }
    const Lanes direction[3] = {at.offset.x * inverse, at.offset.y * inverse, at.offset.z * inverse};
    sh_slopes(model.degree, direction[0], direction[1], direction[2], weights, slope);
    const Lanes along = dot(slope, direction);
    for (int i = 0; i < 3; ++i) mean[i] = mean[i] + (slope[i] - direction[i] * along) * inverse;
}

// `value` where low <= a <= high, else 0.
LANE_INLINE Lanes where_between(const Lanes& a, float low, float high, const Lanes& value) {
    return select_if_at_least(a, low, select_if_at_least(-a, -high, value));
}

// Gradient with respect to the camera's pose: a turn about its own position, then a shift, both along world axes. Each
// amounts to the opposite motion of all Gaussians, except that a turn leaves the viewing directions of the harmonics as
// they are.
struct PoseSlopes {
    Lanes turn[3], shift[3];
};

LANE_INLINE void add_turn(const Lanes* arm, const Lanes* slope, PoseSlopes& pose) {
    Lanes moment[3];
    cross(arm, slope, moment);
    for (int i = 0; i < 3; ++i) pose.turn[i] = pose.turn[i] - moment[i];
}

LANE_INLINE void unproject(const FitModel& model, const Camera& camera, size_t first, const Lanes* moments, float* out,
                           PoseSlopes& pose) {
    const Activated at = activate(model, camera, first);
    const float* R = camera.rotation;
    const Vector<Lanes> seen = rotate(R, at.offset.x, at.offset.y, at.offset.z);
    const Lanes inverse = reciprocal(max(seen.z, NEAR_DEPTH));
    const Lanes slope_x = seen.x * inverse, slope_y = seen.y * inverse;
    const Lanes scale_x = camera.fx * inverse, scale_y = camera.fy * inverse;
    const Lanes bent_x = min(max(slope_x, camera.slope_left), camera.slope_right);
    const Lanes bent_y = min(max(slope_y, camera.slope_top), camera.slope_bottom);
    Lanes deep[3], jx[3], jy[3], conic[3];
    for (int k = 0; k < 3; ++k) {
        const Vector<Lanes> a = rotate(R, at.axes[k], at.axes[3 + k], at.axes[6 + k]);
        deep[k] = a.z;
        jx[k] = scale_x * (a.x - bent_x * a.z), jy[k] = scale_y * (a.y - bent_y * a.z);
    }
    const ShapeSlopes m = shape_slopes(jx, jy, moments, conic);
    const Lanes by_x = conic[0] * moments[M_VX] + conic[1] * moments[M_VY];
    const Lanes by_y = conic[1] * moments[M_VX] + conic[2] * moments[M_VY];
    const Lanes by_bent_x = where_between(slope_x, camera.slope_left, camera.slope_right, scale_x * -dot(m.x, deep));
    const Lanes by_bent_y = where_between(slope_y, camera.slope_top, camera.slope_bottom, scale_y * -dot(m.y, deep));
    const Lanes x = scale_x * by_x + by_bent_x * inverse, y = scale_y * by_y + by_bent_y * inverse;
    const Lanes z = moments[M_DEPTH] - slope_x * x - slope_y * y - (dot(m.x, jx) + dot(m.y, jy)) * inverse;
    Lanes mean[3], by_rotation[9], scales[3], quat[4];
    for (int i = 0; i < 3; ++i) mean[i] = R[i] * x + R[3 + i] * y + R[6 + i] * z;
    const Lanes offset[3] = {at.offset.x, at.offset.y, at.offset.z};
    add_turn(offset, mean, pose);
    for (int k = 0; k < 3; ++k) {
        const Lanes tx = scale_x * m.x[k], ty = scale_y * m.y[k], tz = -(bent_x * tx + bent_y * ty);
        Lanes axis[3];
        for (int i = 0; i < 3; ++i) {
            axis[i] = R[i] * tx + R[3 + i] * ty + R[6 + i] * tz;
            by_rotation[3 * i + k] = axis[i] * at.scales[k];
        }
        const Lanes own[3] = {at.axes[k], at.axes[3 + k], at.axes[6 + k]};
        scales[k] = dot(axis, own);
        add_turn(own, axis, pose);
    }
    quat_slopes(at, by_rotation, quat);
    color_slopes(model, at, first, moments, mean, out);
    for (int i = 0; i < 3; ++i) pose.shift[i] = pose.shift[i] - mean[i];
    for (int i = 0; i < 3; ++i) store(out + size_t(FIT_MEAN + i) * model.stride + first, mean[i]);
    for (int i = 0; i < 3; ++i) store(out + size_t(FIT_LOG_SCALE + i) * model.stride + first, scales[i]);
    for (int i = 0; i < 4; ++i) store(out + size_t(FIT_QUAT + i) * model.stride + first, quat[i]);
    store(out + size_t(FIT_LOGIT) * model.stride + first, moments[M_V] * (1.0f - at.opacity));
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
