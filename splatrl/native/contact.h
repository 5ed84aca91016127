// The first contact of a moving ball or capsule with one voxel. Lengths are in voxels; the voxel is the closed unit box
// at `corner`.
#pragma once

#include "columns.h"

namespace splatrl {
inline namespace EACH_ISA {

// How far a point lies outside the unit box at `corner`, along each axis.
SPLAT_INLINE Vec3 excess(const Vec3& corner, const Vec3& p) {
    Vec3 out;
    for (int i = 0; i < 3; ++i) out[i] = p[i] - clamp(p[i], corner[i], corner[i] + 1.0);
    return out;
}

// The values of s at which the squared distance from p + s v to a unit box changes its formula; infinite or NaN where a
// component of v is 0.
struct Pieces {
    double at[6];
};

SPLAT_INLINE Pieces pieces_of(const Vec3& corner, const Vec3& p, const Vec3& v) {
    Pieces out;
    for (int i = 0; i < 3; ++i) {
        out.at[2 * i] = (corner[i] - p[i]) / v[i];
        out.at[2 * i + 1] = (corner[i] + 1.0 - p[i]) / v[i];
    }
    return out;
}

// The first piece in [0, last] at whose end a condition holds, given that it keeps holding once it does.
struct Piece {
    double from, to;
};

template <class Holds>
SPLAT_INLINE Piece first_piece(const Pieces& pieces, double last, const Holds& holds) {
    Piece out{0.0, last};
    for (double s : pieces.at)
        if (s > 0.0 && s < out.to && holds(s)) out.to = s;
    for (double s : pieces.at)
        if (s > out.from && s < out.to) out.from = s;
    return out;
}

// The s in [0, 1] at which p + s v is nearest to the unit box. The derivative of the squared distance is linear within
// each piece and never decreases.
HOST_DEVICE inline double nearest_on_segment(const Vec3& corner, const Vec3& p, const Vec3& v) {
    const auto slope = [&](double s) { return dot(excess(corner, along(p, v, s)), v); };
    if (slope(0.0) >= 0.0) return 0.0;
    const Piece piece = first_piece(pieces_of(corner, p, v), 1.0, [&](double s) { return slope(s) >= 0.0; });
    const double falls = slope(piece.from), rises = slope(piece.to);
    if (rises < 0.0) return 1.0;
    const double turn = rises - falls, share = turn > 0.0 ? -falls / turn : 0.0;
    return piece.from + share * (piece.to - piece.from);
}

HOST_DEVICE inline double distance_to_segment(const Vec3& corner, const Vec3& p, const Vec3& v) {
    return norm(excess(corner, along(p, v, nearest_on_segment(corner, p, v))));
}

// The first t in [0, 1] at which a ball at p + t v touches the unit box, or NEVER.
HOST_DEVICE inline double ball_contact(const Vec3& corner, const Vec3& p, const Vec3& v, double radius) {
    const double squared = radius * radius;
    const auto gap = [&](double t) {
        const Vec3 e = excess(corner, along(p, v, t));
        return dot(e, e) - squared;
    };
    if (gap(0.0) <= 0.0) return 0.0;
    const double nearest = nearest_on_segment(corner, p, v);
    if (gap(nearest) > 0.0) return NEVER;
    const Piece piece = first_piece(pieces_of(corner, p, v), nearest, [&](double t) { return gap(t) <= 0.0; });
    // Within a piece the excess is e + τ w, where w is the part of v along the axes on which the point is outside.
    const Vec3 e = excess(corner, along(p, v, piece.from));
    const Vec3 middle = excess(corner, along(p, v, 0.5 * (piece.from + piece.to)));
    Vec3 w;
    for (int axis = 0; axis < 3; ++axis) w[axis] = middle[axis] != 0.0 ? v[axis] : 0.0;
    const double a = dot(w, w), b = dot(e, w), c = dot(e, e) - squared;
    const double root = sqrt(max(b * b - a * c, 0.0));
    // The first of two roots, in a form without cancellation.
    return clamp(piece.from + c / (-b + root), piece.from, piece.to);
}

// The same for a capsule whose cylinder reaches from p + t v to p + t v + axis. Translating a convex body by t v
// changes its distance from another by at most |v| t, so steps that would just use up the gap never pass the contact.
// The distance is convex in t, so neither do steps to where the line through the last two gaps is zero, which are much
// longer where the capsule glides along the box; and a gap that has not shrunk never will.
HOST_DEVICE inline double capsule_contact(const Vec3& corner, const Vec3& p, const Vec3& axis, const Vec3& v,
                                          double radius) {
    constexpr double TOUCH = 1e-7, SLACK = 1e-6;  // SLACK outweighs the rounding of a step
    constexpr int MOST_STEPS = 500;
    const double speed = norm(v);
    double t = 0.0, before = 0.0, last = 0.0;
    for (int step = 0; step < MOST_STEPS; ++step) {
        const double gap = distance_to_segment(corner, along(p, v, t), axis) - radius;
        if (gap <= (step == 0 ? 0.0 : TOUCH)) return t;
        if (speed == 0.0 || t >= 1.0 || (step > 0 && gap >= before)) return NEVER;
        double next = t + gap / speed;
        if (step > 0) next = max(next, t + (1.0 - SLACK) * gap * (t - last) / (before - gap));
        before = gap, last = t, t = min(next, 1.0);
    }
    return t;
}

// Whether a moving capsule touches the unit box, with the same answer as `capsule_contact`. The gap changes by at most
// |v| t, so a few samples of it usually decide.
HOST_DEVICE inline bool capsule_touches(const Vec3& corner, const Vec3& p, const Vec3& axis, const Vec3& v,
                                        double radius) {
    constexpr double SURE = 1e-6;
    const double speed = norm(v);
    const auto gap = [&](double t) { return distance_to_segment(corner, along(p, v, t), axis) - radius; };
    const auto apart = [&](double from, double to, double length) { return from + to - length > 2.0 * SURE; };
    const double start = gap(0.0);
    if (start <= 0.0) return true;
    if (speed == 0.0 || start > speed + SURE) return false;
    const double end = gap(1.0);
    if (end <= 0.0) return true;
    if (apart(start, end, speed)) return false;
    const double middle = gap(0.5);
    if (middle <= 0.0) return true;
    if (apart(start, middle, 0.5 * speed) && apart(middle, end, 0.5 * speed)) return false;
    return capsule_contact(corner, p, axis, v, radius) < NEVER;
}

}  // namespace EACH_ISA
}  // namespace splatrl
