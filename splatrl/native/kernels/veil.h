// The veil of a tile: how much of what lies behind shows through what has been blended so far.
#pragma once

#include "kernel.h"
#include "lanes.h"
#include "quads.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Summed-area table of the mean squared transmittance of the blocks.
struct Veil {
    float sums[ACROSS + 1][ACROSS + 1];
};

// The mean of the squares of all lanes, added in the same order with every instruction set.
LANE_INLINE float mean_square(const Lanes& a) {
    const Lanes squares = a * a;
    Quad quads[4];
    std::memcpy(quads, &squares, sizeof(quads));
    const Quad sums = (quads[0] + quads[2]) + (quads[1] + quads[3]);
    return ((sums[0] + sums[2]) + (sums[1] + sums[3])) * (1.0f / LANES);
}

// Compute the veil of what has been blended into these pixels; finished blocks count as opaque.
LANE_INLINE void draw_veil(const float* pixels, const bool* finished, Veil& veil) {
    for (int i = 0; i <= ACROSS; ++i) veil.sums[0][i] = veil.sums[i][0] = 0.0f;
    for (int y = 0; y < ACROSS; ++y) {
        float sum = 0.0f;
        for (int x = 0; x < ACROSS; ++x) {
            const int block = y * ACROSS + x;
            if (!finished[block]) sum += mean_square(load(pixels + (block * CHANNELS + TRANSMITTANCE) * LANES));
            veil.sums[y + 1][x + 1] = veil.sums[y][x + 1] + sum;
        }
    }
}

// Find the first and the last block, along one axis of a tile of so many pixels, onto which a range beyond the near
// plane projects. The range is given by its middle and half its length, metres, and the inverse depths of its nearest
// and its farthest end.
LANE_INLINE void blocks_between(float middle, float half, float nearest, float farthest, float focal, float origin,
                                int pixels, int& first, int& last) {
    const float low = middle - half, high = middle + half;
    const float from = low * (low < 0.0f ? nearest : farthest) * focal + origin;
    const float to = high * (high > 0.0f ? nearest : farthest) * focal + origin;
    const float end = float(pixels - 1);
    first = int(splatrl::min(splatrl::max(from, 0.0f), end)) / BLOCK;
    last = int(splatrl::min(splatrl::max(to, 0.0f), end)) / BLOCK;
}

// The mean squared transmittance over the blocks onto which a box beyond the near plane projects.
LANE_INLINE float seen_through(const Veil& veil, const Camera& camera, const Tile& tile, const Box& box) {
    float middle[3], half[3];
    for (int row = 0; row < 3; ++row) {
        middle[row] = half[row] = 0.0f;
        for (int axis = 0; axis < 3; ++axis) {
            const float along = camera.rotation[3 * row + axis];
            middle[row] += along * (box.center[axis] - camera.position[axis]);
            half[row] += splatrl::max(along, -along) * box.half[axis];
        }
    }
    const float nearest = 1.0f / splatrl::max(middle[2] - half[2], NEAR_DEPTH);
    const float farthest = 1.0f / splatrl::max(middle[2] + half[2], NEAR_DEPTH);
    int left, right, top, bottom;
    blocks_between(middle[0], half[0], nearest, farthest, camera.fx, camera.cx - float(tile.left),
                   tile.right - tile.left, left, right);
    blocks_between(middle[1], half[1], nearest, farthest, camera.fy, camera.cy - float(tile.top),
                   tile.bottom - tile.top, top, bottom);
    const float *above = veil.sums[top], *below = veil.sums[bottom + 1];
    const float sum = below[right + 1] - below[left] - above[right + 1] + above[left];
    return sum / float((right + 1 - left) * (bottom + 1 - top));
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
