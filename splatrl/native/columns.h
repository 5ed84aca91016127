// Solid voxels within a range of a grid, column by column.
#pragma once

#include <algorithm>
#include <cstdint>

#include "collision.h"

namespace splatrl {

constexpr double SLACK = 1e-9;  // voxels: rounding of what is computed here

// Of numbers that an int holds; the library's are calls where the processor's are not assumed.
inline int floor_of(double value) {
    const int whole = int(value);
    return whole - (value < whole);
}

inline int ceil_of(double value) { return -floor_of(-value); }

struct Range {
    int first, last;
};

// The voxels that [low, high] touches along an axis.
inline Range touched(double low, double high, int size) {
    const double first = std::min(std::max(low - SLACK, 0.0), size + 1.0);
    const double last = std::min(std::max(high + SLACK, -1.0), size - 0.5);
    return {std::max(ceil_of(first) - 1, 0), floor_of(last)};
}

// Bits [first, last] of a word, both in [0, 63].
inline uint64_t mask_of(int first, int last) { return ~0ull << first & ~0ull >> (63 - last); }

// Call visit(z) for each solid voxel of a column from `first` to `last`, until it returns true.
template <class Visit>
bool any_solid(const uint64_t* column, int first, int last, const Visit& visit) {
    for (int word = first / 64; first <= last && word <= last / 64; ++word) {
        const int low = std::max(first - 64 * word, 0), high = std::min(last - 64 * word, 63);
        for (uint64_t bits = column[word] & mask_of(low, high); bits != 0; bits &= bits - 1)
            if (visit(64 * word + __builtin_ctzll(bits))) return true;
    }
    return false;
}

// The numbers of a range, from the middle outwards: what overlaps a body is found early.
struct FromMiddle {
    Range range;
    int middle = (range.first + range.last) / 2;

    int count() const { return range.last - range.first + 1; }
    int operator[](int i) const {
        const int half = (i + 1) / 2;
        return i % 2 == 0 ? middle - half : middle + half;
    }
};

// Call visit(x, y, column, z range) for each column with something solid within a box, until it returns true.
template <class Visit>
void each_column(const Grid& grid, const Vec3& low, const Vec3& high, const Visit& visit) {
    const FromMiddle xs{touched(low[0], high[0], grid.size[0])}, ys{touched(low[1], high[1], grid.size[1])};
    const Range zs = touched(low[2], high[2], grid.size[2]);
    const auto found = [](int) { return true; };
    for (int i = 0; i < xs.count(); ++i)
        for (int k = 0; k < ys.count(); ++k) {
            const int x = xs[i], y = ys[k];
            const uint64_t* column = &grid.bits[(size_t(x) * grid.size[1] + y) * grid.words];
            if (any_solid(column, zs.first, zs.last, found) && visit(x, y, column, zs)) return;
        }
}

}  // namespace splatrl
