// Points inside a body, at a grid of 3×3×3 of them. Most collisions are so deep that one of these points lies in a
// solid voxel, which costs little to find out.
#pragma once

#include "collision.h"

namespace splatrl {

constexpr int POINTS_INSIDE = 27;
// Share of the way to the surface: neither rounding nor a rotation that is orthonormal only to within ORTHONORMAL may
// take a point out of the body.
constexpr double WELL_INSIDE = 0.998;

// The i-th point, in voxels in the frame of the body: a box's center, corners, and middles of its edges and faces; the
// same directions from the centers of a capsule's caps and of its cylinder, or from a sphere's center.
SPLAT_INLINE Vec3 point_inside(const Shape& shape, int i) {
    const int at[3] = {i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1};
    const int squares = at[0] * at[0] + at[1] * at[1] + at[2] * at[2];
    const double radius = shape.radius * (squares == 2 ? 0.70710678 : squares == 3 ? 0.57735026 : 1.0);
    Vec3 out;
    for (int k = 0; k < 3; ++k) out[k] = WELL_INSIDE * at[k] * (shape.kind == Shape::BOX ? shape.half[k] : radius);
    if (shape.kind == Shape::CAPSULE) out[2] += at[2] * shape.half_length;
    return out;
}

SPLAT_INLINE bool is_solid(const Grid& grid, const Vec3& point) {
    int index[3];
    for (int i = 0; i < 3; ++i) {
        if (!(point[i] >= 0.0 && point[i] < grid.size[i])) return false;
        index[i] = int(point[i]);
    }
    const uint64_t* column = grid.bits + (size_t(index[0]) * grid.size[1] + index[1]) * grid.words;
    return (column[index[2] / 64] >> index[2] % 64 & 1u) != 0;
}

// Whether some point inside a body, with the rotation of a pose matrix and at a position in voxels, is solid.
SPLAT_INLINE bool holds_solid(const Grid& grid, const Shape& shape, const float* pose, const Vec3& position) {
#pragma unroll 1
    for (int i = 0; i < POINTS_INSIDE; ++i) {
        const Vec3 inside = point_inside(shape, i);
        Vec3 point = position;
        for (int k = 0; k < 3; ++k)
            point[k] += pose[4 * k] * inside[0] + pose[4 * k + 1] * inside[1] + pose[4 * k + 2] * inside[2];
        if (is_solid(grid, point)) return true;
    }
    return false;
}

}  // namespace splatrl
