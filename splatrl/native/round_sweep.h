// A sphere or a capsule, at rest or moving in a straight line, against voxels.
#pragma once

#include "collision_pose.h"
#include "collision_shape.h"
#include "contact.h"

namespace splatrl {
inline namespace EACH_ISA {

constexpr double PARALLEL = 1e-10;  // the squared sine below which two directions count as parallel

// The parallelogram that a cylinder's axis sweeps over: bottom + s axis + t way for s and t in [0, 1].
struct Swept {
    Vec3 bottom, axis, way;
    double along, across, turning;           // |axis|², |way|² and the dot product of axis and way
    double per_along, per_across, per_area;  // inverses; 0 where the divisor would be 0

    // The way to a point from the nearest place: find the best s over all t, the best t for that s, and the best s for
    // that t.
    HOST_DEVICE Vec3 way_to(const Vec3& point) const {
        const Vec3 off = between(bottom, point);
        const double u = dot(off, axis), v = dot(off, way);
        double s = clamp((across * u - turning * v) * per_area, 0.0, 1.0);
        const double t = clamp((v - s * turning) * per_across, 0.0, 1.0);
        s = clamp((u - t * turning) * per_along, 0.0, 1.0);
        return {off[0] - s * axis[0] - t * way[0], off[1] - s * axis[1] - t * way[1],
                off[2] - s * axis[2] - t * way[2]};
    }
};

SPLAT_INLINE Swept swept_by(const Vec3& bottom, const Vec3& axis, const Vec3& way) {
    const auto inverse = [](double a) { return a > 0.0 ? 1.0 / a : 0.0; };
    Swept out{bottom, axis, way, dot(axis, axis), dot(way, way), dot(axis, way), 0.0, 0.0, 0.0};
    const double area = out.along * out.across - out.turning * out.turning;
    out.per_along = inverse(out.along);
    out.per_across = inverse(out.across);
    out.per_area = area > PARALLEL * out.along * out.across ? 1.0 / area : 0.0;
    return out;
}

struct RoundSweep {
    Swept swept;  // at the start, the cylinder reaches from bottom to bottom + axis
    double radius;
    bool ball;  // whether the axis has length 0
    // Only for a capsule, squared: a voxel surely touches if it reaches within `near` of what the axis sweeps over, and
    // surely does not if its centre is further away than `far`, or if it ends more than `apart` before a plane through
    // the nearest place. Where the capsule moves nearly along its axis, that place is not exact, and `apart` infinite.
    double near, far, apart;

    HOST_DEVICE double contact(const Column& column, bool any) const {
        double first = NEVER;
        any_solid(column, [&](int z) {
            const Vec3 corner{double(column.x), double(column.y), double(z)};
            first = min(first, ball ? of_ball(corner, any) : of_capsule(corner, any));
            return first == 0.0;
        });
        return first;
    }

private:
    HOST_DEVICE double of_ball(const Vec3& corner, bool any) const {
        const double t = ball_contact(corner, swept.bottom, swept.way, radius);
        return any && t < NEVER ? 0.0 : t;
    }

    HOST_DEVICE double of_capsule(const Vec3& corner, bool any) const {
        const Vec3 way = swept.way_to({corner[0] + 0.5, corner[1] + 0.5, corner[2] + 0.5});
        const double squared = dot(way, way);
        if (squared > far) return NEVER;
        Vec3 outside;
        double ends = squared;  // times the distance of the centre: how far from the plane the voxel ends
        for (int i = 0; i < 3; ++i) {
            outside[i] = max(fabs(way[i]) - 0.5, 0.0);
            ends -= 0.5 * fabs(way[i]);
        }
        if (any && dot(outside, outside) <= near) return 0.0;
        if (ends > 0.0 && ends * ends > apart * squared) return NEVER;
        if (!any) return capsule_contact(corner, swept.bottom, swept.axis, swept.way, radius);
        return capsule_touches(corner, swept.bottom, swept.axis, swept.way, radius) ? 0.0 : NEVER;
    }
};

SPLAT_INLINE RoundSweep round_sweep(const Shape& shape, const Pose& pose, const Vec3& way) {
    // Voxels: more than the errors of the searches for a contact, and of the nearest place.
    constexpr double SURE = 1e-6, SURELY_APART = 1e-4;
    const bool ball = shape.kind == Shape::SPHERE;
    Vec3 bottom = pose.position, axis{};
    for (int i = 0; i < 3; ++i) {
        axis[i] = ball ? 0.0 : 2.0 * shape.half_length * pose.rotation[i][2];
        bottom[i] -= 0.5 * axis[i];
    }
    RoundSweep out{{bottom, axis, way}, shape.radius + SLACK, ball, 0.0, 0.0, 0.0};
    if (ball) return out;
    out.swept = swept_by(bottom, axis, way);
    const double unsure = SURE + 2.0 * sqrt(PARALLEL * (out.swept.along + out.swept.across));
    const double far = shape.radius + HALF_DIAGONAL + unsure;
    out.near = shape.radius * shape.radius;
    out.far = far * far;
    const double apart = shape.radius + SURELY_APART;
    const bool parallel = out.swept.across > 0.0 && out.swept.per_area == 0.0;
    out.apart = parallel ? NEVER : apart * apart;
    return out;
}

}  // namespace EACH_ISA
}  // namespace splatrl
