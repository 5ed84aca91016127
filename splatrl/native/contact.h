// When a moving body first touches one voxel. Lengths in voxels; the voxel is the closed unit box at `corner`.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "collision.h"

namespace splatrl {

constexpr double NEVER = std::numeric_limits<double>::infinity();

inline double dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline Vec3 cross(const Vec3& a, const Vec3& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline Vec3 along(const Vec3& p, const Vec3& d, double t) {
    return {p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]};
}
inline double norm(const Vec3& a) { return std::sqrt(dot(a, a)); }

// From the unit box at `corner` to a point: what the point lies beyond it.
inline Vec3 excess(const Vec3& corner, const Vec3& p) {
    Vec3 out;
    for (int i = 0; i < 3; ++i) out[i] = p[i] - std::clamp(p[i], corner[i], corner[i] + 1.0);
    return out;
}

// Where on p + s v, s in [0, 1], the squared distance to a unit box changes its formula, with both ends, in order.
struct Pieces {
    double at[8];
    int count = 0;

    Pieces(const Vec3& corner, const Vec3& p, const Vec3& v) {
        at[count++] = 0.0;
        for (int i = 0; i < 3; ++i)
            for (double face : {corner[i], corner[i] + 1.0}) {
                const double s = (face - p[i]) / v[i];
                if (s > 0.0 && s < 1.0) at[count++] = s;
            }
        std::sort(at + 1, at + count);
        at[count++] = 1.0;
    }
};

// The s in [0, 1] at which p + s v is nearest to the unit box: the slope of the squared distance is linear between the
// pieces and never falls.
inline double nearest_on_segment(const Vec3& corner, const Vec3& p, const Vec3& v) {
    double last = dot(excess(corner, p), v);
    if (last >= 0.0) return 0.0;
    const Pieces pieces(corner, p, v);
    for (int i = 1; i < pieces.count; ++i) {
        const double slope = dot(excess(corner, along(p, v, pieces.at[i])), v);
        if (slope >= 0.0) {
            const double rise = slope - last, share = rise > 0.0 ? -last / rise : 0.0;
            return pieces.at[i - 1] + share * (pieces.at[i] - pieces.at[i - 1]);
        }
        last = slope;
    }
    return 1.0;
}

inline double distance_to_segment(const Vec3& corner, const Vec3& p, const Vec3& v) {
    return norm(excess(corner, along(p, v, nearest_on_segment(corner, p, v))));
}

// The first t in [0, 1] at which a ball at p + t v touches the unit box, or NEVER.
inline double ball_contact(const Vec3& corner, const Vec3& p, const Vec3& v, double radius) {
    const double squared = radius * radius;
    const auto gap = [&](double t) {
        const Vec3 e = excess(corner, along(p, v, t));
        return dot(e, e) - squared;
    };
    if (gap(0.0) <= 0.0) return 0.0;
    const double nearest = nearest_on_segment(corner, p, v);
    if (gap(nearest) > 0.0) return NEVER;
    const Pieces pieces(corner, p, v);
    for (int i = 1; i < pieces.count; ++i) {
        const double from = pieces.at[i - 1], to = std::min(pieces.at[i], nearest);
        if (gap(to) > 0.0) continue;
        // Between two pieces the excess is e + τ w, with w the part of v along the axes that are outside.
        const Vec3 e = excess(corner, along(p, v, from)), middle = excess(corner, along(p, v, 0.5 * (from + to)));
        Vec3 w;
        for (int axis = 0; axis < 3; ++axis) w[axis] = middle[axis] != 0.0 ? v[axis] : 0.0;
        const double a = dot(w, w), b = dot(e, w), c = dot(e, e) - squared;
        const double root = std::sqrt(std::max(b * b - a * c, 0.0));
        return std::clamp(from + c / (-b + root), from, to);  // of two roots the first, without cancellation
    }
    return nearest;
}

// The same for a capsule whose cylinder is p + t v to p + t v + axis. Distance between convex bodies under a translation
// is at most |v| t away from what it was: steps of that never pass the contact.
inline double capsule_contact(const Vec3& corner, const Vec3& p, const Vec3& axis, const Vec3& v, double radius) {
    constexpr double TOUCH = 1e-7;
    constexpr int MOST_STEPS = 500;
    const double speed = norm(v);
    double t = 0.0;
    for (int step = 0; step < MOST_STEPS; ++step) {
        const double gap = distance_to_segment(corner, along(p, v, t), axis) - radius;
        if (gap <= (step == 0 ? 0.0 : TOUCH)) return t;
        if (speed == 0.0 || t >= 1.0) return NEVER;
        t = std::min(t + gap / speed, 1.0);
    }
    return t;
}

}  // namespace splatrl
