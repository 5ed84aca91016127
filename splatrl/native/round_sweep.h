// A sphere or a capsule, at rest or on a straight way, against voxels.
#pragma once

#include "collision_pose.h"
#include "collision_shape.h"
#include "contact.h"

namespace splatrl {
inline namespace EACH_ISA {

struct RoundSweep {
    Vec3 bottom, axis, way;  // the cylinder is bottom to bottom + axis at the start
    double radius;
    bool ball;  // the axis has length 0

    HOST_DEVICE double contact(const Column& column, bool any) const {
        double first = NEVER;
        any_solid(column, [&](int z) {
            const Vec3 corner{double(column.x), double(column.y), double(z)};
            if (!ball && any)
                first = capsule_touches(corner, bottom, axis, way, radius) ? 0.0 : NEVER;
            else {
                const double t = ball ? ball_contact(corner, bottom, way, radius)
                                      : capsule_contact(corner, bottom, axis, way, radius);
                first = any && t < NEVER ? 0.0 : min(first, t);
            }
            return first == 0.0;
        });
        return first;
    }
};

SPLAT_INLINE RoundSweep round_sweep(const Shape& shape, const Pose& pose, const Vec3& way) {
    RoundSweep out{pose.position, {}, way, shape.radius + SLACK, shape.kind == Shape::SPHERE};
    for (int i = 0; i < 3; ++i) {
        out.axis[i] = out.ball ? 0.0 : 2.0 * shape.half_length * pose.rotation[i][2];
        out.bottom[i] -= 0.5 * out.axis[i];
    }
    return out;
}

}  // namespace EACH_ISA
}  // namespace splatrl
