// The mathematics of a splat, for one number or a vector of them, on any processor.
//
// `F` is a number type: float, or Lanes of sixteen floats. Its overloads of reciprocal, reciprocal_sqrt, log2, exp2,
// exp2_if_at_least, min and max are found where a template is instantiated. The formulas are those of
// renderers/reference.py, with one change for precision: covariances are kept as factors A (Σ = A Aᵀ), which give
// determinants without cancellation.
#pragma once

#include "camera.h"
#include "inline.h"
#include "scalars.h"

namespace splatrl {

constexpr float NEAR_DEPTH = 0.01f;           // metres
constexpr float DILATION = 0.3f;              // square pixels
constexpr float MAX_ALPHA = 0.999f;
constexpr float LOG2_BELOW_PEAK = -0.0016f;   // opacities up to here stay below MAX_ALPHA, however they are rounded
constexpr float MIN_TRANSMITTANCE = 1e-4f;
constexpr float LOG2_GREY_LEVEL = -7.99435344f;             // log2(1 / 255)
constexpr float LOG2_INVISIBLE_ANTIALIASED = -9.99435344f;  // a quarter: distant surfaces are many faint Gaussians
constexpr float HALF_LOG2_E = 0.72134752f, ROOT_HALF_LOG2_E = 0.84932180f;
constexpr float SH_C0 = 0.28209479177387814f;

// A Gaussian on the image: alpha(p) = min(peak, 2^(log2_opacity - u² - v²)), where u = l11 dx + l12 dy, v = l22 dy and
// (dx, dy) = p - mean.
template <class F>
struct Footprint {
    F x, y, depth;        // pixels, pixels, metres
    F l11, l12, l22;      // 1 / pixels
    F log2_opacity, peak;
    F extent_x, extent_y; // half the size of the box in which it can be visible, pixels
};

// The transmittance at which a pixel is finished. In exact images the splat that would bring it down to that is left
// out, as in gsplat. If what is shown may be displaced by a pixel, a quarter of a grey level may be missing from
// behind, and the last splat is blended.
SPLAT_INLINE float finished_at(float tolerance) {
    constexpr float PER_PIXEL = 1e-3f, MOST = 1e-3f;
    return max(MIN_TRANSMITTANCE, min(PER_PIXEL * tolerance, MOST));
}

// log2 of the opacity below which a splat is invisible at a pixel: a grey level in classic images, a quarter of it in
// antialiased ones. If what is shown may be displaced by half a pixel, a full level may be missing at a splat's rim:
// what is distant and faint has been merged, and neighbouring splats cover each other's rims.
SPLAT_INLINE float log2_invisible_at(float tolerance, bool antialiased) {
    constexpr float LEVELS_PER_PIXEL = 2.0f, MOST_LEVELS = 1.0f, LEAST_LEVELS = 0.25f;
    if (!antialiased) return LOG2_GREY_LEVEL;
    const float levels = min(LEVELS_PER_PIXEL * tolerance, MOST_LEVELS);
    return levels > LEAST_LEVELS ? LOG2_GREY_LEVEL + log2(levels) : LOG2_INVISIBLE_ANTIALIASED;
}

// Whether Gaussians are ordered by their depths in double precision, and ties are broken. What may be displaced by
// pixels may be drawn in the order of the tree where depths hardly differ.
SPLAT_INLINE bool ranked_at(float tolerance) {
    constexpr float LEAST = 1.0f / 64.0f;
    return tolerance < LEAST;
}

template <class F>
struct Vector {
    F x, y, z;
};

template <class F>
SPLAT_INLINE Vector<F> rotate(const float* rotation, F x, F y, F z) {
    return {x * rotation[0] + y * rotation[1] + z * rotation[2], x * rotation[3] + y * rotation[4] + z * rotation[5],
            x * rotation[6] + y * rotation[7] + z * rotation[8]};
}

// What a merged Gaussian stands for: `members` Gaussians of equal mass, whose opacities add up to `sum`. Zero members
// mark one of the scene's own.
template <class F>
struct Merging {
    F members, sum;
};

// n Gaussians that lie within one, each with x / n of its mass, have the opacity 1 - (1 - x g / n)^n where its fall-off
// is g: a fall-off with a flat top, below a peak. min(peak, 2^log2_opacity g) has the same peak and nearly the same
// integral, which is peak (1 + ln(2^log2_opacity / peak)). The ratio in the logarithm is a fit for many members,
// extended to few members by y: it is too low for few members that cover each other, and it never adds opacity.
template <class F>
SPLAT_INLINE void merge_opacities(F x, F members, F& log2_opacity, F& peak) {
    const F share = reciprocal(members);
    const F opacity = 1.0f - exp2(max(members * log2(1.0f - min(x * share, MAX_ALPHA)), -60.0f));
    const F y = x * (1.0f - share);
    const F ratio = 1.0f + y * (0.25f + 0.0475f * y * reciprocal(1.0f + 0.07f * y));
    peak = min(opacity, MAX_ALPHA);
    log2_opacity = log2(max(opacity * ratio, 1e-12f));
}

// A Gaussian projected onto the image plane, before dilation.
template <class F>
struct Flat {
    F x, y, depth;  // pixels, pixels, metres
    F xx, yy, xy;   // covariance, square pixels
    F determinant;
};

// A row of J · rotation: the derivative of an image coordinate by the position in the world, given x / z or y / z.
template <class F>
SPLAT_INLINE Vector<F> slope_of(const Camera& camera, int row, F scale, F slope) {
    const float *along = camera.rotation + 3 * row, *forward = camera.rotation + 6;
    return {scale * (along[0] - slope * forward[0]), scale * (along[1] - slope * forward[1]),
            scale * (along[2] - slope * forward[2])};
}

// The row v · A for a factor A of a covariance, row-major.
template <class F>
SPLAT_INLINE Vector<F> times(Vector<F> v, const F (&a)[9]) {
    return {v.x * a[0] + v.y * a[3] + v.z * a[6], v.x * a[1] + v.y * a[4] + v.z * a[7],
            v.x * a[2] + v.y * a[5] + v.z * a[8]};
}

// The row v · A for a factor A whose upper triangle is zero and left out.
template <class F>
SPLAT_INLINE Vector<F> times(Vector<F> v, const F (&a)[6]) {
    return {v.x * a[0] + v.y * a[1] + v.z * a[3], v.y * a[2] + v.z * a[4], v.z * a[5]};
}

// Flatten a Gaussian whose mean is at `offset` from the camera (world axes) and whose covariance has the factor `axes`.
// Meaningful only where depth >= NEAR_DEPTH. EWA: eq. 29 to 31 of Zwicker et al. 2001.
template <class F, int NUMBERS>
SPLAT_INLINE Flat<F> flatten(const Camera& camera, Vector<F> offset, const F (&axes)[NUMBERS]) {
    const Vector<F> mean = rotate(camera.rotation, offset.x, offset.y, offset.z);
    const F inverse_depth = reciprocal(max(mean.z, NEAR_DEPTH));
    const F slope_x = mean.x * inverse_depth, slope_y = mean.y * inverse_depth;
    const F scale_x = camera.fx * inverse_depth, scale_y = camera.fy * inverse_depth;
    const F bent_x = min(max(slope_x, camera.slope_left), camera.slope_right);
    const F bent_y = min(max(slope_y, camera.slope_top), camera.slope_bottom);

    const Vector<F> jx = times(slope_of(camera, 0, scale_x, bent_x), axes);  // the rows of J · rotation · A
    const Vector<F> jy = times(slope_of(camera, 1, scale_y, bent_y), axes);
    const F minor_x = jx.y * jy.z - jx.z * jy.y;
    const F minor_y = jx.z * jy.x - jx.x * jy.z;
    const F minor_z = jx.x * jy.y - jx.y * jy.x;
    Flat<F> out;
    out.x = slope_x * camera.fx + camera.cx;
    out.y = slope_y * camera.fy + camera.cy;
    out.depth = mean.z;
    out.xx = jx.x * jx.x + jx.y * jx.y + jx.z * jx.z;
    out.yy = jy.x * jy.x + jy.y * jy.y + jy.z * jy.z;
    out.xy = jx.x * jy.x + jx.y * jy.y + jx.z * jy.z;
    // det(M Mᵀ) is the sum of the squared minors of M (Cauchy–Binet).
    out.determinant = minor_x * minor_x + minor_y * minor_y + minor_z * minor_z;
    return out;
}

// The footprint of a flattened Gaussian, which is visible where it is no fainter than `log2_invisible`.
template <bool ANTIALIASED, bool MERGED, class F>
SPLAT_INLINE Footprint<F> dilate(const Flat<F>& flat, F log2_opacity, Merging<F> merging, float log2_invisible) {
    const F determinant = flat.determinant + (flat.xx + flat.yy) * DILATION + DILATION * DILATION;
    const F xx = flat.xx + DILATION, yy = flat.yy + DILATION;

    Footprint<F> out;
    out.x = flat.x;
    out.y = flat.y;
    out.depth = flat.depth;
    out.log2_opacity = log2_opacity;
    out.peak = log2_opacity * 0.0f + MAX_ALPHA;
    const F inverse_root = reciprocal_sqrt(determinant);
    if (ANTIALIASED)
        out.log2_opacity = log2_opacity + 0.5f * log2(max(flat.determinant * (inverse_root * inverse_root), 1e-30f));
    if (MERGED && stand_for_many(merging.members)) {
        F mass = exp2(max(out.log2_opacity, -60.0f));
        if (!ANTIALIASED) {  // each member is dilated
            const F bare = max(flat.determinant, 1e-20f);
            mass = (mass * (bare * reciprocal_sqrt(bare)) + DILATION * merging.sum) * inverse_root;
        }
        merge_opacities(mass, merging.members, out.log2_opacity, out.peak);
    }
    // The Cholesky factor of the inverse covariance, free of cancellation however thin the ellipse.
    const F root_xx = xx * reciprocal_sqrt(xx), inverse_root_yy = reciprocal_sqrt(yy), root_yy = yy * inverse_root_yy;
    const F l11 = ROOT_HALF_LOG2_E * (root_yy * inverse_root);
    out.l11 = l11;
    out.l12 = -(l11 * (flat.xy * (inverse_root_yy * inverse_root_yy)));
    out.l22 = ROOT_HALF_LOG2_E * inverse_root_yy;
    // alpha becomes invisible at u² + v² = log2_opacity - log2_invisible. This is that ellipse's box, slightly wider.
    const F squared_reach = max(out.log2_opacity - log2_invisible, 1e-30f) * (1.0002f / HALF_LOG2_E);
    const F reach = squared_reach * reciprocal_sqrt(squared_reach);
    out.extent_x = reach * root_xx;
    out.extent_y = reach * root_yy;
    return out;
}

// Project a Gaussian: flatten it, then dilate it.
template <bool ANTIALIASED, bool MERGED, class F, int NUMBERS>
SPLAT_INLINE Footprint<F> project(const Camera& camera, Vector<F> offset, const F (&axes)[NUMBERS], F log2_opacity,
                                  Merging<F> merging, float log2_invisible) {
    return dilate<ANTIALIASED, MERGED>(flatten(camera, offset, axes), log2_opacity, merging, log2_invisible);
}

// The (degree + 1)² basis functions along a unit direction, as in spherical_harmonics.py. A colour is their dot product
// with the coefficients, plus 0.5, clamped at 0 from below.
template <class F>
SPLAT_INLINE void sh_basis(int degree, F x, F y, F z, F* basis) {
    basis[0] = x * 0.0f + SH_C0;
    if (degree < 1) return;
    basis[1] = -0.4886025119029199f * y;
    basis[2] = 0.4886025119029199f * z;
    basis[3] = -0.4886025119029199f * x;
    if (degree < 2) return;
    const F xx = x * x, yy = y * y, zz = z * z;
    basis[4] = 1.0925484305920792f * (x * y);
    basis[5] = -1.0925484305920792f * (y * z);
    basis[6] = 0.31539156525252005f * (2.0f * zz - xx - yy);
    basis[7] = -1.0925484305920792f * (x * z);
    basis[8] = 0.5462742152960396f * (xx - yy);
    if (degree < 3) return;
    basis[9] = -0.5900435899266435f * (y * (3.0f * xx - yy));
    basis[10] = 2.890611442640554f * (x * y * z);
    basis[11] = -0.4570457994644658f * (y * (4.0f * zz - xx - yy));
    basis[12] = 0.3731763325901154f * (z * (2.0f * zz - 3.0f * xx - 3.0f * yy));
    basis[13] = -0.4570457994644658f * (x * (4.0f * zz - xx - yy));
    basis[14] = 1.445305721320277f * (z * (xx - yy));
    basis[15] = -0.5900435899266435f * (x * (xx - 3.0f * yy));
}

// The gradient [3] by x, y and z of the dot product of weights [(degree + 1)²] with the basis functions.
template <class F>
SPLAT_INLINE void sh_slopes(int degree, F x, F y, F z, const F* weights, F* out) {
    out[0] = out[1] = out[2] = x * 0.0f;
    if (degree < 1) return;
    const F* w = weights;
    out[0] = -0.4886025119029199f * w[3];
    out[1] = -0.4886025119029199f * w[1];
    out[2] = 0.4886025119029199f * w[2];
    if (degree < 2) return;
    out[0] = out[0] + 1.0925484305920792f * (w[4] * y - w[7] * z + w[8] * x) - 0.6307831305050401f * (w[6] * x);
    out[1] = out[1] + 1.0925484305920792f * (w[4] * x - w[5] * z - w[8] * y) - 0.6307831305050401f * (w[6] * y);
    out[2] = out[2] - 1.0925484305920792f * (w[5] * y + w[7] * x) + 1.2615662610100802f * (w[6] * z);
    if (degree < 3) return;
    const F xx = x * x, yy = y * y, zz = z * z, xy = x * y, xz = x * z, yz = y * z;
    out[0] = out[0] - 0.5900435899266435f * (6.0f * (w[9] * xy) + 3.0f * (w[15] * (xx - yy))) +
             2.890611442640554f * (w[10] * yz + w[14] * xz) +
             0.4570457994644658f * (2.0f * (w[11] * xy) - w[13] * (4.0f * zz - 3.0f * xx - yy)) -
             2.2390579955406924f * (w[12] * xz);
    out[1] = out[1] - 0.5900435899266435f * (3.0f * (w[9] * (xx - yy)) - 6.0f * (w[15] * xy)) +
             2.890611442640554f * (w[10] * xz - w[14] * yz) +
             0.4570457994644658f * (2.0f * (w[13] * xy) - w[11] * (4.0f * zz - xx - 3.0f * yy)) -
             2.2390579955406924f * (w[12] * yz);
    out[2] = out[2] + 2.890611442640554f * (w[10] * xy) - 3.6563663957157264f * (w[11] * yz + w[13] * xz) +
             1.1195289977703462f * (w[12] * (2.0f * zz - xx - yy)) + 1.445305721320277f * (w[14] * (xx - yy));
}

// The opacity of a splat given u and v, 0 where it is invisible. PEAKED is false if it cannot exceed the peak anyway.
template <bool PEAKED = true, class F>
SPLAT_INLINE F alpha_of(F u, F v, float log2_opacity, float peak, float log2_invisible) {
    const F exponent = log2_opacity - u * u - v * v;
    const F alpha = exp2_if_at_least(exponent, log2_invisible);
    return PEAKED ? min(alpha, peak) : alpha;
}

// The opacity of a splat at a pixel.
template <bool PEAKED = true, class F>
SPLAT_INLINE F alpha_at(F dx, F dy, float l11, float l12, float l22, float log2_opacity, float peak,
                        float log2_invisible) {
    return alpha_of<PEAKED>(dx * l11 + dy * l12, dy * l22, log2_opacity, peak, log2_invisible);
}

}  // namespace splatrl
