// A box, at rest or moving in a straight line, against voxels, by separating axes: two convex bodies are apart if their
// projections onto some axis are. It suffices to test the face normals of the box and of the voxel, and the cross
// products of an edge of one with an edge of the other; while the box moves, its path counts as an edge too.
#pragma once

#include "collision_pose.h"
#include "collision_shape.h"
#include "columns.h"

namespace splatrl {
inline namespace EACH_ISA {

struct Normal {
    Vec3 axis;
    double inverse_z;  // 0 if the axis has no z component
    double reach;      // half extents of box and voxel along the axis, added up
    double swept;      // the same plus half the path
    double speed;      // displacement of the box along the axis from t = 0 to 1
    bool still;        // whether the axis depends on the bodies alone, not on the path
};

// The edges from which the normals are computed.
struct BoxWay {
    Vec3 half, way, direction;
    Mat3 edges;   // rows: the box's edges, unit vectors
    int normals;  // upper bound on their number
};

constexpr int NORMALS = 21, NORMALS_AT_REST = 12;  // at rest, the voxel's own normals are not needed: columns are
                                                   // already limited to the bounding box of the body

SPLAT_INLINE BoxWay box_way(const Shape& shape, const Pose& pose, const Vec3& way) {
    const double length = norm(way);
    BoxWay out{shape.half, way, {}, {}, length == 0.0 ? NORMALS_AT_REST : NORMALS};
    for (int i = 0; i < 3; ++i) {
        out.edges[i] = column_of(pose.rotation, i);
        out.direction[i] = length == 0.0 ? 0.0 : way[i] / length;
    }
    return out;
}

SPLAT_INLINE Vec3 row_of(const Mat3& matrix, int i) { return i == 0 ? matrix[0] : i == 1 ? matrix[1] : matrix[2]; }
SPLAT_INLINE Vec3 unit(int axis) { return {double(axis == 0), double(axis == 1), double(axis == 2)}; }

SPLAT_INLINE Vec3 normal_axis(const BoxWay& box, int i) {
    const int kind = i / 3, which = i % 3;
    if (kind == 0) return row_of(box.edges, which);
    if (kind < 4) return cross(unit(kind - 1), row_of(box.edges, which));
    if (kind == 4) return unit(which);
    return cross(kind == 5 ? unit(which) : row_of(box.edges, which), box.direction);
}

// Compute the i-th normal. Returns false for parallel edges, which have none; then another normal decides.
SPLAT_INLINE bool make_normal(const BoxWay& box, int i, Normal& out) {
    const Vec3 axis = normal_axis(box, i);
    double reach = SLACK;
    for (int k = 0; k < 3; ++k) reach += 0.5 * fabs(axis[k]) + box.half[k] * fabs(dot(box.edges[k], axis));
    const double speed = dot(box.way, axis);
    const double inverse_z = fabs(axis[2]) > 1e-9 ? 1.0 / axis[2] : 0.0;
    out = {axis, inverse_z, reach, reach + 0.5 * fabs(speed), speed, i < 15};
    return norm(axis) >= 1e-6;
}

struct BoxSweep {
    Vec3 start, middle;
    const Normal* normals;
    int count;

    // The range of heights in a column at which voxels may be touched along the path.
    HOST_DEVICE Range touched_in(const Column& column) const {
        const Range& zs = column.zs;
        double low = zs.first - middle[2] + 0.5, high = zs.last - middle[2] + 0.5;  // of voxel centres
        const double dx = column.x + 0.5 - middle[0], dy = column.y + 0.5 - middle[1];
        for (int i = 0; i < count; ++i) {
            const Normal& n = normals[i];
            const double base = n.axis[0] * dx + n.axis[1] * dy;
            if (n.inverse_z == 0.0) {
                if (fabs(base) > n.swept) return {0, -1};
                continue;
            }
            const double center = -base * n.inverse_z, half = n.swept * fabs(n.inverse_z);
            low = max(low, center - half);
            high = min(high, center + half);
            if (low > high + 2.0 * SLACK) return {0, -1};
        }
        const int first = ceil_of(low + middle[2] - 0.5 - SLACK), last = floor_of(high + middle[2] - 0.5 + SLACK);
        return {max(first, zs.first), min(last, zs.last)};
    }

    // The first t in [0, 1] at which the box touches a voxel, or NEVER.
    HOST_DEVICE double contact_with(int x, int y, int z) const {
        const Vec3 apart{x + 0.5 - start[0], y + 0.5 - start[1], z + 0.5 - start[2]};
        double enter = 0.0, leave = 1.0;
        for (int i = 0; i < count; ++i) {
            const Normal& n = normals[i];
            if (!n.still) continue;
            const double from = dot(apart, n.axis), speed = n.speed;
            if (fabs(speed) < 1e-12) {
                if (fabs(from) > n.reach) return NEVER;
                continue;
            }
            const double a = (from - n.reach) / speed, b = (from + n.reach) / speed;
            enter = max(enter, min(a, b));
            leave = min(leave, max(a, b));
        }
        return enter <= leave ? enter : NEVER;
    }

    // The first contact with any voxel of a column. With `any`, only whether there is one: 0 or NEVER.
    HOST_DEVICE double contact(Column column, bool any) const {
        column.zs = touched_in(column);
        double first = NEVER;
        any_solid(column, [&](int z) {
            first = any ? 0.0 : min(first, contact_with(column.x, column.y, z));
            return first == 0.0;
        });
        return first;
    }
};

}  // namespace EACH_ISA
}  // namespace splatrl
