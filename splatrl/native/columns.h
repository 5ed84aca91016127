// The solid voxels within a box of a grid, column by column.
#pragma once

#include "collision_grid.h"

namespace splatrl {
inline namespace EACH_ISA {

constexpr double SLACK = 1e-9;  // voxels: covers the rounding errors of these computations

struct Range {
    int first, last;
};

// The range of voxels that [low, high] touches along an axis.
SPLAT_INLINE Range touched(double low, double high, int size) {
    const double first = min(max(low - SLACK, 0.0), size + 1.0);
    const double last = min(max(high + SLACK, -1.0), size - 0.5);
    return {max(ceil_of(first) - 1, 0), floor_of(last)};
}

// A mask of the bits [first, last] of a word, both in [0, 63].
SPLAT_INLINE uint64_t mask_of(int first, int last) { return ~uint64_t(0) << first & ~uint64_t(0) >> (63 - last); }

SPLAT_INLINE int lowest_bit(uint64_t bits) {
#ifdef __CUDA_ARCH__
    return __ffsll(bits) - 1;
#else
    return __builtin_ctzll(bits);
#endif
}

// The voxels of a grid at one x and y, within a range of heights.
struct Column {
    int x, y;
    Range zs;
    const uint64_t* bits;
};

// Call visit(z) for each solid voxel of a column until it returns true; returns whether it did.
template <class Visit>
SPLAT_INLINE bool any_solid(const Column& column, const Visit& visit) {
    const Range& zs = column.zs;
    for (int word = zs.first / 64; zs.first <= zs.last && word <= zs.last / 64; ++word) {
        const int low = max(zs.first - 64 * word, 0), high = min(zs.last - 64 * word, 63);
        for (uint64_t bits = column.bits[word] & mask_of(low, high); bits != 0; bits &= bits - 1)
            if (visit(64 * word + lowest_bit(bits))) return true;
    }
    return false;
}

// The i-th number of a range, counted from its middle outwards, so that an overlap with the body is found early.
SPLAT_INLINE int from_middle(Range range, int i) {
    const int middle = (range.first + range.last) / 2, half = (i + 1) / 2;
    return i % 2 == 0 ? middle - half : middle + half;
}

// The columns of a grid within a box.
struct Columns {
    const Grid& grid;
    Range xs, ys, zs;

    HOST_DEVICE Columns(const Grid& grid, const Vec3& low, const Vec3& high)
        : grid(grid),
          xs(touched(low[0], high[0], grid.size[0])),
          ys(touched(low[1], high[1], grid.size[1])),
          zs(touched(low[2], high[2], grid.size[2])) {}

    // The number of columns along x; 0 if there are none, or if they hold no voxels.
    HOST_DEVICE int along_x() const { return zs.first <= zs.last ? max(xs.last - xs.first + 1, 0) : 0; }
    // The number of columns along y.
    HOST_DEVICE int along_y() const { return max(ys.last - ys.first + 1, 0); }

    HOST_DEVICE Column column(int x, int y) const {
        return {x, y, zs, grid.bits + (size_t(x) * grid.size[1] + y) * grid.words};
    }

    HOST_DEVICE bool any_solid_in(const Column& column) const {
        const int first = zs.first / 64, last = zs.last / 64;
        const uint64_t from = ~uint64_t(0) << zs.first % 64, to = ~uint64_t(0) >> (63 - zs.last % 64);
        if (first == last) return (column.bits[first] & from & to) != 0;
        uint64_t found = (column.bits[first] & from) | (column.bits[last] & to);
        for (int word = first + 1; word < last; ++word) found |= column.bits[word];
        return found != 0;
    }
};

}  // namespace EACH_ISA
}  // namespace splatrl
