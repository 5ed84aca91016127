// Rigid poses and the rotation between two of them. Poses come as row-major 4×4 matrices in metres.
#pragma once

#include "collision_grid.h"

namespace splatrl {
inline namespace EACH_ISA {

struct Pose {
    Mat3 rotation;  // body_to_world
    Vec3 position;  // voxels
};

SPLAT_INLINE Vec3 position_of(const Grid& grid, const float* matrix) {
    return place_of(grid, matrix[3], matrix[7], matrix[11]);
}

SPLAT_INLINE Pose pose_of(const Grid& grid, const float* matrix) {
    Pose pose;
    pose.position = position_of(grid, matrix);
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) pose.rotation[i][k] = matrix[4 * i + k];
    return pose;
}

// Apply a rotation by an angle about a unit axis (Rodrigues) to another rotation.
HOST_DEVICE inline Mat3 turned(const Vec3& axis, double angle, const Mat3& rotation) {
    const double c = cos(angle), s = sin(angle);
    Mat3 out;
    for (int column = 0; column < 3; ++column) {
        const Vec3 v = column_of(rotation, column), side = cross(axis, v);
        const double share = dot(axis, v) * (1.0 - c);
        for (int i = 0; i < 3; ++i) out[i][column] = v[i] * c + side[i] * s + axis[i] * share;
    }
    return out;
}

// Set the axis of the rotation from one orientation to another, and return its angle in [0, π].
HOST_DEVICE inline double turn_between(const Mat3& from, const Mat3& to, Vec3& axis) {
    Mat3 turn;  // to · fromᵀ
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) turn[i][k] = dot(to[i], from[k]);
    const Vec3 doubled{turn[2][1] - turn[1][2], turn[0][2] - turn[2][0], turn[1][0] - turn[0][1]};
    const double sine = 0.5 * norm(doubled), cosine = 0.5 * (turn[0][0] + turn[1][1] + turn[2][2] - 1.0);
    if (sine > 1e-6) {
        for (int i = 0; i < 3; ++i) axis[i] = 0.5 * doubled[i] / sine;
    } else {  // almost no turn, where any axis will do, or half a turn, where turn + I is 2 axis axisᵀ
        double best = -2.0;
        for (int k = 0; k < 3; ++k)
            if (turn[k][k] > best) {
                best = turn[k][k];
                axis = column_of(turn, k);
                axis[k] += 1.0;
            }
        const double length = norm(axis);
        for (int i = 0; i < 3; ++i) axis[i] /= length;
    }
    return atan2(sine, cosine);
}

}  // namespace EACH_ISA
}  // namespace splatrl
