// A grid of solid voxels and its distance field.
//
// Lengths are in voxels, and positions are relative to the corner of the grid; the voxel (x, y, z) is the closed box
// from that point to (x + 1, y + 1, z + 1). Everything outside the grid is free.
#pragma once

#include "collision_vectors.h"

namespace splatrl {

constexpr double NEVER = INFINITE;
constexpr double DISTANCE_STEPS = 256.0;
constexpr uint16_t FARTHEST = 0xffff;
constexpr double HALF_DIAGONAL = 0.8660254037844387;  // half the diagonal of a voxel

// A view of memory that it does not own.
struct Grid {
    int size[3];
    int words;                   // per column
    bool empty;                  // whether nothing is solid, in which case nothing below is read
    double resolution, inverse;  // edge of a voxel, metres, and one over it
    Vec3 corner;                 // of the grid in the world, metres
    const uint64_t* bits;        // [x, y, words]: bit z of a column is the voxel (x, y, z)
    // [x, y, z] distance from the centre of each voxel to that of the nearest solid one, in units of 1 / DISTANCE_STEPS
    // of a voxel, rounded down and at most FARTHEST.
    const uint16_t* distance;
};

// Convert a world point, metres, to grid coordinates.
SPLAT_INLINE Vec3 place_of(const Grid& grid, float x, float y, float z) {
    const Vec3& corner = grid.corner;
    return {(x - corner[0]) * grid.inverse, (y - corner[1]) * grid.inverse, (z - corner[2]) * grid.inverse};
}

// A point clamped to the grid: the nearest point of the grid, and the voxel that contains it.
struct Place {
    Vec3 within;
    int index[3];
    size_t voxel;
};

SPLAT_INLINE Place nearest_place(const Grid& grid, const Vec3& point) {
    Place out;
    for (int i = 0; i < 3; ++i) {
        out.within[i] = min(max(point[i], 0.0), double(grid.size[i]));
        out.index[i] = min(int(out.within[i]), grid.size[i] - 1);
    }
    out.voxel = (size_t(out.index[0]) * grid.size[1] + out.index[1]) * grid.size[2] + out.index[2];
    return out;
}

struct Nearby {
    double at_least, at_most;  // bounds on the distance to the nearest solid voxel, and to the nearest centre of one
};

SPLAT_INLINE Nearby nearby(const Grid& grid, const Vec3& point) {
    const Place place = nearest_place(grid, point);
    double outside = 0.0, to_center = 0.0;
    for (int i = 0; i < 3; ++i) {
        const double out = point[i] - place.within[i], off = place.within[i] - place.index[i] - 0.5;
        outside += out * out;
        to_center += off * off;
    }
    to_center = sqrt(to_center);
    const uint16_t steps = grid.distance[place.voxel];
    const double inside = max(steps / DISTANCE_STEPS - HALF_DIAGONAL - to_center, 0.0);
    if (outside > 0.0) return {sqrt(outside + inside * inside), NEVER};
    return {inside, steps == FARTHEST ? NEVER : (steps + 1) / DISTANCE_STEPS + to_center};
}

// A lower bound on the distance from a point to the nearest solid voxel.
SPLAT_INLINE double clearance(const Grid& grid, const Vec3& point) {
    return grid.empty ? NEVER : nearby(grid, point).at_least;
}

SPLAT_INLINE float clearance_in_metres(const Grid& grid, const Vec3& point) {
    return float(clearance(grid, point) * grid.resolution * (1.0 - 1e-6));  // still a lower bound in single precision
}

}  // namespace splatrl
