// The first contact of a shape, moving in a straight line without turning, with anything solid: one column at a time.
#pragma once

#include "box_sweep.h"
#include "round_sweep.h"

namespace splatrl {
inline namespace EACH_ISA {

// The columns that the bounding box of a shape touches along its way.
SPLAT_INLINE Columns columns_on_way(const Grid& grid, const Shape& shape, const Pose& pose, const Vec3& way) {
    const Vec3 half = half_extents(shape, pose.rotation);
    Vec3 low, high;
    for (int i = 0; i < 3; ++i) {
        low[i] = pose.position[i] + min(way[i], 0.0) - half[i];
        high[i] = pose.position[i] + max(way[i], 0.0) + half[i];
    }
    return Columns(grid, low, high);
}

// The smallest result of contact(column) over the columns that hold a solid voxel; stops at 0.
template <class Contact>
inline double first_of_columns(const Columns& columns, const Contact& contact) {
    double first = NEVER;
    const int along_x = columns.along_x(), along_y = columns.along_y();
    for (int i = 0; i < along_x; ++i)
        for (int k = 0; k < along_y; ++k) {
            const Column column = columns.column(from_middle(columns.xs, i), from_middle(columns.ys, k));
            if (!columns.any_solid_in(column)) continue;
            first = min(first, contact(column));
            if (first == 0.0) return first;
        }
    return first;
}

// The `contact` of collision.h on a CPU.
struct FirstContact {
    const Grid& grid;

    double operator()(const Shape& shape, const Pose& pose, const Vec3& way, bool any) const {
        const Columns columns = columns_on_way(grid, shape, pose, way);
        if (shape.kind != Shape::BOX) {
            const RoundSweep sweep = round_sweep(shape, pose, way);
            return first_of_columns(columns, [&](const Column& column) { return sweep.contact(column, any); });
        }
        Normal normals[NORMALS];
        BoxSweep sweep{pose.position, along(pose.position, way, 0.5), normals, 0};
        return first_of_columns(columns, [&](const Column& column) {
            if (sweep.count == 0) {  // computed once the first solid voxel is found
                const BoxWay box = box_way(shape, pose, way);
                for (int i = 0; i < box.normals; ++i) sweep.count += make_normal(box, i, normals[sweep.count]);
            }
            return sweep.contact(column, any);
        });
    }
};

}  // namespace EACH_ISA
}  // namespace splatrl
