// Ray casting against a grid of solid voxels, for the range of a lidar's beams. Shared by CPU and CUDA.
//
// Lengths are in voxels, and positions are relative to the corner of the grid. A point belongs to the voxel
// [x, x + 1) × [y, y + 1) × [z, z + 1) that contains it, so a ray that runs within a face meets the voxels above it.
// Everything outside the grid is free.
//
// A ray advances from the edge of one empty cube of voxels to the edge of the next: a voxel traversal (Amanatides and
// Woo 1987) with steps as long as the free space allows. The point where it enters a voxel is computed from that
// voxel's own planes, so errors do not accumulate along a ray.
//
// The number type N is a double or a vector of doubles; indices are whole numbers of that type.
#pragma once

#include "collision_vectors.h"

namespace splatrl {

constexpr double ALONG_A_PLANE = 1e300;  // stands for 1 / 0: a plane that a ray never crosses is beyond any reach

// A view of memory that it does not own.
struct RayGrid {
    int size[3];
    double resolution, inverse;  // edge of a voxel, metres, and one over it
    Vec3 corner;                 // of the grid in the world, metres
    // [z, x, y], so that horizontal scans stay within few layers: chessboard (Chebyshev) distance in voxels from each
    // voxel to the nearest solid one; 0 if it is solid itself, at most 255. A final 0 follows, for ended rays.
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
    N from, way, inverse;  // components of its origin and of its unit direction, and one over the latter
    N index;               // of the voxel that the ray is in
};

template <class N>
SPLAT_INLINE N inverse_of(const N& way) {
    return choose(way == 0.0, ALONG_A_PLANE + N{}, 1.0 / choose(way == 0.0, 1.0 + N{}, way));
}

// Clip the range [first, last] of a ray to the grid along one axis; it becomes empty if the ray is never inside.
template <class N>
SPLAT_INLINE void clip(const RayAxis<N>& axis, double size, N& first, N& last) {
    first = most(first, (choose(axis.way < 0.0, size + N{}, N{}) - axis.from) * axis.inverse);
    last = least(last, (choose(axis.way < 0.0, N{}, size + N{}) - axis.from) * axis.inverse);
}

template <class N>
SPLAT_INLINE N index_at(const RayAxis<N>& axis, const N& t, const N& low, const N& high) {
    return least(most(whole_below(axis.from + t * axis.way), low), high);
}

// Where a ray leaves, along one axis, the empty cube with `room` - 1 voxels to each side of its own.
template <class N>
SPLAT_INLINE N leaves(const RayAxis<N>& axis, const N& room) {
    return (axis.index + choose(axis.way < 0.0, 1.0 - room, room) - axis.from) * axis.inverse;
}

// The index, along one axis, of the voxel that the ray enters when it leaves that cube at t: just outside the cube on
// the axis through which it leaves, still within it on the others.
template <class N>
SPLAT_INLINE N beyond(const RayAxis<N>& axis, const N& room, const N& mine, const N& t) {
    const N within = index_at(axis, t, axis.index + 1.0 - room, axis.index + room - 1.0);
    return choose(mine <= t, axis.index + choose(axis.way < 0.0, -room, room), within);
}

// Advance to the edge of the empty cube around a ray's voxel. Returns whether the ray has reached neither its end nor
// the edge of the grid.
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
