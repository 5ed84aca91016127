// Rays against a grid of solid voxels: how far a lidar's beam reaches. Shared by CPU and CUDA.
//
// Lengths are in voxels and positions count from the corner of the grid. A point belongs to the voxel
// [x, x + 1) × [y, y + 1) × [z, z + 1) that holds it, so a ray that runs within a face meets the voxels above it. What lies
// outside the grid is free.
//
// A ray goes from the edge of one empty cube of voxels to the edge of the next: a traversal of voxels (Amanatides and Woo
// 1987) with steps as long as the place allows. Where it enters a voxel is computed from that voxel's own planes, so errors
// do not add up along a ray.
//
// A number N is a double, or several of them as a vector; indices are whole numbers in it.
#pragma once

#include "collision_vectors.h"

namespace splatrl {

constexpr double ALONG_A_PLANE = 1e300;  // stands for 1 / 0: a plane that a ray never crosses lies beyond all reach

// A view of memory that others own.
struct RayGrid {
    int size[3];
    double resolution, inverse;  // metres of a voxel, and one over it
    Vec3 corner;                 // of the grid in the world, metres
    // [z, x, y], so that level scans stay in few layers: how many steps along axes and diagonals it is from each voxel to
    // the nearest solid one; 0 where it is solid itself, at most 255. A 0 follows, for rays that are over.
    const uint8_t* room;
};

template <class M, class N>
SPLAT_INLINE N choose(const M& first, const N& a, const N& b) {
    return first ? a : b;
}

template <class N>
SPLAT_INLINE N whole_below(const N& value) {
    constexpr double FAR = 6755399441055744.0;  // 1.5 · 2^52, where doubles are whole numbers
    const N near = value + FAR - FAR;
    return near > value ? near - 1.0 : near;
}

template <class N>
SPLAT_INLINE N least(const N& a, const N& b) {
    return choose(b < a, b, a);
}

template <class N>
SPLAT_INLINE N most(const N& a, const N& b) {
    return choose(a < b, b, a);
}

// One axis of a ray.
template <class N>
struct RayAxis {
    N from, way, inverse;  // a component of a unit vector, and one over it
    N index;               // of the voxel in which the ray is
};

template <class N>
SPLAT_INLINE N inverse_of(const N& way) {
    return choose(way == 0.0, ALONG_A_PLANE + N{}, 1.0 / choose(way == 0.0, 1.0 + N{}, way));
}

// The stretch [first, last] of a ray within the grid along an axis; empty where it is never there.
template <class N>
SPLAT_INLINE void clip(const RayAxis<N>& axis, double size, N& first, N& last) {
    first = most(first, (choose(axis.way < 0.0, size + N{}, N{}) - axis.from) * axis.inverse);
    last = least(last, (choose(axis.way < 0.0, N{}, size + N{}) - axis.from) * axis.inverse);
}

template <class N>
SPLAT_INLINE N index_at(const RayAxis<N>& axis, const N& t, const N& low, const N& high) {
    return least(most(whole_below(axis.from + t * axis.way), low), high);
}

// Where a ray leaves the empty cube with `room` - 1 voxels to each side of its own.
template <class N>
SPLAT_INLINE N leaves(const RayAxis<N>& axis, const N& room) {
    return (axis.index + choose(axis.way < 0.0, 1.0 - room, room) - axis.from) * axis.inverse;
}

// The index of the voxel just beyond that cube, which the ray leaves at t; along other axes it is still within.
template <class N>
SPLAT_INLINE N beyond(const RayAxis<N>& axis, const N& room, const N& mine, const N& t) {
    const N within = index_at(axis, t, axis.index + 1.0 - room, axis.index + room - 1.0);
    return choose(mine <= t, axis.index + choose(axis.way < 0.0, -room, room), within);
}

// Go to the edge of the empty cube around a ray's voxel; returns whether something lies ahead.
template <class N>
SPLAT_INLINE auto advance(RayAxis<N> (&axes)[3], const N& room, const int (&size)[3], const N& last, N& t) {
    const N by[3] = {leaves(axes[0], room), leaves(axes[1], room), leaves(axes[2], room)};
    t = least(least(by[0], by[1]), by[2]);
    auto ahead = t < last;
    for (int i = 0; i < 3; ++i) {
        const N to = beyond(axes[i], room, by[i], t);
        axes[i].index = least(most(to, N{}), double(size[i] - 1) + N{});
        ahead = ahead & (axes[i].index == to);
    }
    return ahead;
}

}  // namespace splatrl
