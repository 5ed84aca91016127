// Whether a row-major 4×4 matrix is a rigid pose: a rotation and a finite translation.
#pragma once

#include "inline.h"

#ifndef __CUDACC__
#include <cmath>
#include <cstring>

#include "quads.h"
#endif

namespace splatrl {

constexpr float ORTHONORMAL = 1e-3f;

// Checks that the columns of the rotation are orthonormal and right-handed, by their squared lengths, the dot product
// of each with the next, and their determinant.
SPLAT_INLINE bool is_pose(const float* matrix) {
    const float *x = matrix, *y = matrix + 4, *z = matrix + 8, *last = matrix + 12;
    float off[10], volume = 0.0f;
    for (int i = 0; i < 3; ++i) {
        const int next = (i + 1) % 3, after = (i + 2) % 3;
        off[i] = x[i] * x[i] + y[i] * y[i] + z[i] * z[i] - 1.0f;
        off[3 + i] = x[i] * x[next] + y[i] * y[next] + z[i] * z[next];
        off[6 + i] = last[i];
        volume += z[i] * (x[next] * y[after] - x[after] * y[next]);
    }
    off[9] = last[3] - 1.0f;
    // The sum is NaN if the position is not finite.
    bool right = volume > 0.0f && 0.0f * x[3] + 0.0f * y[3] + 0.0f * z[3] == 0.0f;
    for (float value : off) right &= fabs(value) <= ORTHONORMAL;
    return right;
}

#ifndef __CUDACC__

SPLAT_INLINE Quad next_of(const Quad& a) { return PICK(a, a, 1, 2, 0, 3); }        // y, z, x
SPLAT_INLINE Quad after_next_of(const Quad& a) { return PICK(a, a, 2, 0, 1, 3); }  // z, x, y

// The same as `is_pose`, but faster where registers hold four numbers.
SPLAT_INLINE bool is_pose_by_fours(const float* matrix) {
    Quad rows[4];
    std::memcpy(rows, matrix, sizeof(rows));
    // The fourth lane is 0, or NaN if the position is not finite. After this the position is masked out.
    const Quad position = 0.0f * rows[0] + 0.0f * rows[1] + 0.0f * rows[2];
    const QuadIndex three = {-1, -1, -1, 0};
    const Quad x = (Quad)((QuadIndex)rows[0] & three), y = (Quad)((QuadIndex)rows[1] & three);
    const Quad z = (Quad)((QuadIndex)rows[2] & three);
    const Quad squares = x * x + y * y + z * z - Quad{1.0f, 1.0f, 1.0f, 0.0f};
    const Quad products = x * next_of(x) + y * next_of(y) + z * next_of(z);
    const Quad volume = z * (next_of(x) * after_next_of(y) - after_next_of(x) * next_of(y));
    const Quad last = rows[3] - Quad{0.0f, 0.0f, 0.0f, 1.0f};
    const auto small = [](const Quad& a) { return (a <= ORTHONORMAL) & (a >= -ORTHONORMAL); };
    const auto right = small(squares) & small(products) & small(last) & small(position);
    return (right[0] & right[1] & right[2] & right[3]) != 0 && volume[0] + volume[1] + volume[2] > 0.0f;
}

#endif

}  // namespace splatrl
