// A grid that owns its memory.
#pragma once

#include <algorithm>
#include <vector>

#include "buffer.h"
#include "collision_grid.h"

namespace splatrl {

class PackedGrid {
public:
    // `solid` is whether each voxel is solid, `metres` the distance from its centre to that of the nearest solid one;
    // both are [x, y, z].
    PackedGrid(const bool* solid, const float* metres, const int (&size)[3], const Vec3& corner, double resolution)
        : grid_{{size[0], size[1], size[2]}, (size[2] + 63) / 64, true, resolution, 1.0 / resolution, corner, nullptr,
                nullptr} {
        const size_t columns = size_t(size[0]) * size[1], height = size[2];
        bits_.assign(columns * grid_.words, 0);
        for (size_t column = 0; column < columns; ++column)
            for (size_t z = 0; z < height; ++z) {
                const bool filled = solid[column * height + z];
                bits_[column * grid_.words + z / 64] |= uint64_t(filled) << z % 64;
                grid_.empty &= !filled;
            }
        distance_ = make_buffer<uint16_t>(columns * height);
        for (size_t i = 0; i < columns * height; ++i) {
            const double steps = metres[i] / resolution * (1.0 - 1e-6) * DISTANCE_STEPS;  // allow for single precision
            distance_[i] = uint16_t(std::min(steps, double(FARTHEST)));
        }
        grid_.bits = bits_.data();
        grid_.distance = distance_.get();
    }

    const Grid& view() const { return grid_; }

private:
    std::vector<uint64_t> bits_;
    Buffer<uint16_t> distance_;
    Grid grid_;
};

}  // namespace splatrl
