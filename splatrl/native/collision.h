// Collisions of bodies with a grid of solid voxels: at a pose, and along the way from one pose to another.
//
// Lengths are in voxels, and positions are relative to the corner of the grid. A touch is a hit. Everything outside the
// grid is free. Arithmetic is in double precision. CPU and CUDA share all of this except `contact(shape, pose, way,
// any)`, the search for the first contact: a CPU examines one column at a time, a GPU many. It returns the first t in
// [0, 1], or NEVER; with `any`, a value below NEVER says only that something is touched.
#pragma once

#include "collision_pose.h"
#include "collision_shape.h"

namespace splatrl {
inline namespace EACH_ISA {

constexpr double MARGIN = 1e-4;      // voxels: more than the rounding error of a distance field in single precision
constexpr double TURN_SLACK = 0.1;   // voxels by which a turning body may be grown
constexpr double MOST_PARTS_OF_TURN = 16384.0;
constexpr double NEARLY_ALL = 1.0 - 1e-7;

// What the distance field alone says about a pose; MAYBE is left for `touches` to decide.
enum class Verdict { FREE, HIT, MAYBE };

SPLAT_INLINE Verdict judge(const Grid& grid, const Shape& shape, const Vec3& position) {
    if (grid.empty) return Verdict::FREE;
    const Nearby near = nearby(grid, position);
    const bool free = near.at_least > shape.outer + MARGIN, hit = near.at_most <= shape.inner - MARGIN;
    return Verdict(2 - 2 * int(free) - int(hit));  // never both
}

template <class Contact>
SPLAT_INLINE bool touches(const Shape& shape, const Pose& pose, const Contact& contact) {
    return contact(shape, pose, Vec3{0.0, 0.0, 0.0}, true) == 0.0;
}

// Whether the distance field alone proves that a straight move touches nothing.
SPLAT_INLINE bool passes(const Grid& grid, const Shape& shape, const Vec3& start, const Vec3& way) {
    return clearance(grid, along(start, way, 0.5)) > shape.outer + 0.5 * norm(way) + MARGIN;
}

// A rotation about one axis, cut into parts, each of which uses the orientation at its middle.
struct Turn {
    Vec3 axis;
    double angle;  // 0 if there is no rotation
    int parts;
};

SPLAT_INLINE Turn turn_of(const Shape& shape, const Mat3& from, const Mat3& to) {
    Turn out{{0.0, 0.0, 0.0}, 0.0, 1};
    if (shape.kind == Shape::SPHERE || same(from, to)) return out;
    out.angle = turn_between(from, to, out.axis);
    // In a part that turns by φ, up to φ / 2 to either side of its middle, a point is off by at most 2 R sin(φ / 4).
    // If that would take too many parts, the slack grows with their angle instead, so nothing is missed.
    out.parts = int(min(max(ceil(0.5 * shape.outer * out.angle / TURN_SLACK), 1.0), MOST_PARTS_OF_TURN));
    return out;
}

// The fraction of a straight move, turning at a constant rate about one axis, that is free: 1 if nothing is touched,
// ends included. Exact at a fixed orientation (within 1e-6 voxels for a capsule). In each part of a turn the body is
// grown by the most that its points may be off (TURN_SLACK, unless the number of parts is capped), so the result is
// never too large. With `any`, a value below 1 says only that something is touched. Callers check first whether the
// move `passes`; that is not repeated here.
template <class Contact>
HOST_DEVICE inline double free_fraction(const Grid& grid, const Shape& shape, const Pose& start, const Pose& end,
                                           bool any, const Contact& contact) {
    const Vec3 way = between(start.position, end.position);
    const Turn turn = turn_of(shape, start.rotation, end.rotation);
    if (turn.angle == 0.0) {
        const double first = contact(shape, start, way, any);
        return first <= 1.0 ? min(first, NEARLY_ALL) : 1.0;
    }
    const double slack = 2.0 * shape.outer * sin(0.25 * turn.angle / turn.parts);
    // Parts -1 and turn.parts test the start and the end pose at rest.
    for (int part = -1; part <= turn.parts; ++part) {
        const bool rests = part < 0 || part == turn.parts;
        const Shape tested = grown(shape, rests ? 0.0 : slack);
        const Vec3 goes = along(Vec3{0.0, 0.0, 0.0}, way, rests ? 0.0 : 1.0 / turn.parts);
        Pose pose = part < turn.parts ? start : end;
        if (!rests) pose.position = along(start.position, way, double(part) / turn.parts);
        if (passes(grid, tested, pose.position, goes)) continue;
        if (!rests) pose.rotation = turned(turn.axis, turn.angle * (part + 0.5) / turn.parts, start.rotation);
        const bool hit = rests && judge(grid, shape, pose.position) == Verdict::HIT;
        const double first = hit ? 0.0 : contact(tested, pose, goes, any || rests);
        if (first <= 1.0) return min(max(part + first, 0.0) / turn.parts, NEARLY_ALL);
    }
    return 1.0;
}

}  // namespace EACH_ISA
}  // namespace splatrl
