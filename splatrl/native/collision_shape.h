// The shape that is tested against a grid; lengths are in voxels.
#pragma once

#include "collision_vectors.h"

namespace splatrl {

// A box (half extents), a sphere, or a capsule along its own z axis (half length of its cylinder).
struct Shape {
    enum Kind { BOX, SPHERE, CAPSULE } kind;
    Vec3 half;
    double half_length, radius;
    double inner, outer;  // radii of the largest ball about the origin inside it, and of the smallest around it
};

SPLAT_INLINE Shape shape_of(Shape::Kind kind, const Vec3& half, double half_length, double radius) {
    const bool box = kind == Shape::BOX;
    return {kind, half, half_length, radius, box ? min(min(half[0], half[1]), half[2]) : radius,
            box ? norm(half) : radius + half_length};
}

SPLAT_INLINE Shape grown(const Shape& shape, double by) {
    if (shape.kind == Shape::BOX)
        return shape_of(Shape::BOX, {shape.half[0] + by, shape.half[1] + by, shape.half[2] + by}, 0.0, 0.0);
    return shape_of(shape.kind, shape.half, shape.half_length, shape.radius + by);
}

// Half extents of the axis-aligned bounding box of a rotated shape.
SPLAT_INLINE Vec3 half_extents(const Shape& shape, const Mat3& rotation) {
    Vec3 out;
    for (int i = 0; i < 3; ++i) {
        out[i] = shape.radius;
        if (shape.kind == Shape::CAPSULE) out[i] += shape.half_length * fabs(rotation[i][2]);
        if (shape.kind == Shape::BOX)
            for (int k = 0; k < 3; ++k) out[i] += shape.half[k] * fabs(rotation[i][k]);
    }
    return out;
}

}  // namespace splatrl
