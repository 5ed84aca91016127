// A box, at rest or on a straight way, against voxels.
#pragma once

#include <algorithm>
#include <cmath>

#include "columns.h"
#include "contact.h"

namespace splatrl {

// A box on a straight way, against voxels. Two convex bodies are apart where their shadows on some normal are: of the
// box, the voxel, and each pair of an edge of one and an edge of the other; while the box moves, the way is an edge too.
class BoxSweep {
public:
    BoxSweep(const Shape& shape, const Pose& pose, const Vec3& way) : start_(pose.position), way_(way) {
        Mat3 edges;  // of the box, unit
        for (int i = 0; i < 3; ++i) edges[i] = {pose.rotation[0][i], pose.rotation[1][i], pose.rotation[2][i]};
        for (int i = 0; i < 3; ++i) middle_[i] = start_[i] + 0.5 * way[i];
        const double length = norm(way);
        const Mat3 world{Vec3{1.0, 0.0, 0.0}, Vec3{0.0, 1.0, 0.0}, Vec3{0.0, 0.0, 1.0}};
        for (const Vec3& edge : edges) add(shape, edges, edge, true);
        for (const Vec3& axis : world)
            for (const Vec3& edge : edges) add(shape, edges, cross(axis, edge), true);
        if (length == 0.0) return;  // the columns are within the box around the body: no need for its own normals
        const Vec3 direction{way[0] / length, way[1] / length, way[2] / length};
        for (const Vec3& axis : world) {
            add(shape, edges, axis, true);
            add(shape, edges, cross(axis, direction), false);
        }
        for (const Vec3& edge : edges) add(shape, edges, cross(edge, direction), false);
    }

    // The voxels of a column that are touched on the way.
    Range column(int x, int y, Range zs) const {
        double low = zs.first - middle_[2] + 0.5, high = zs.last - middle_[2] + 0.5;  // of the voxels' centres
        const double dx = x + 0.5 - middle_[0], dy = y + 0.5 - middle_[1];
        for (int i = 0; i < count_; ++i) {
            const Normal& n = normals_[i];
            const double base = n.axis[0] * dx + n.axis[1] * dy;
            if (n.inverse_z == 0.0) {
                if (std::fabs(base) > n.swept) return {0, -1};
                continue;
            }
            const double center = -base * n.inverse_z, half = n.swept * std::fabs(n.inverse_z);
            low = std::max(low, center - half);
            high = std::min(high, center + half);
            if (low > high + 2.0 * SLACK) return {0, -1};
        }
        return {ceil_of(low + middle_[2] - 0.5 - SLACK), floor_of(high + middle_[2] - 0.5 + SLACK)};
    }

    // The first t in [0, 1] at which a voxel is touched, or NEVER.
    double contact(int x, int y, int z) const {
        const Vec3 apart{x + 0.5 - start_[0], y + 0.5 - start_[1], z + 0.5 - start_[2]};
        double enter = 0.0, leave = 1.0;
        for (int i = 0; i < count_; ++i) {
            const Normal& n = normals_[i];
            if (!n.still) continue;
            const double from = dot(apart, n.axis), speed = n.speed;
            if (std::fabs(speed) < 1e-12) {
                if (std::fabs(from) > n.reach) return NEVER;
                continue;
            }
            const double a = (from - n.reach) / speed, b = (from + n.reach) / speed;
            enter = std::max(enter, std::min(a, b));
            leave = std::min(leave, std::max(a, b));
        }
        return enter <= leave ? enter : NEVER;
    }

private:
    struct Normal {
        Vec3 axis;
        double inverse_z;  // 0 where the axis has no z
        double reach;      // of box and voxel together, at rest
        double swept;      // and with half the way
        double speed;      // of the box along the axis
        bool still;        // whether it belongs to the bodies, not to the way
    };

    void add(const Shape& shape, const Mat3& edges, const Vec3& axis, bool still) {
        const double length = norm(axis);
        if (length < 1e-6) return;  // parallel edges: another normal decides
        double reach = SLACK;
        for (int i = 0; i < 3; ++i) reach += 0.5 * std::fabs(axis[i]) + shape.half[i] * std::fabs(dot(edges[i], axis));
        const double speed = dot(way_, axis);
        const double inverse_z = std::fabs(axis[2]) > 1e-9 ? 1.0 / axis[2] : 0.0;
        normals_[count_++] = {axis, inverse_z, reach, reach + 0.5 * std::fabs(speed), speed, still};
    }

    Vec3 start_, way_, middle_;
    Normal normals_[21];
    int count_ = 0;
};

}  // namespace splatrl
