// Orders points so that neighbours in memory are neighbours in space, at every scale.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "threads.h"

namespace splatrl {

constexpr uint32_t POLLED = 1u << 16;  // comparisons from one poll to the next

// Halve [first, last) along its longest axis, at a multiple of `leaf`, and return the middle. `mean` returns the three
// coordinates of an item.
template <class Mean>
uint32_t* halve(uint32_t* first, uint32_t* last, size_t leaf, const Mean& mean) {
    float low[3], high[3];
    std::copy_n(mean(*first), 3, low);
    std::copy_n(mean(*first), 3, high);
    for (const uint32_t* item = first; item != last; ++item)
        for (int axis = 0; axis < 3; ++axis) {
            low[axis] = std::min(low[axis], mean(*item)[axis]);
            high[axis] = std::max(high[axis], mean(*item)[axis]);
        }
    int longest = 0;
    for (int axis = 1; axis < 3; ++axis)
        if (high[axis] - low[axis] > high[longest] - low[longest]) longest = axis;
    const size_t leaves = (size_t(last - first) + leaf - 1) / leaf;
    uint32_t* middle = first + (leaves + 1) / 2 * leaf;
    uint32_t compared = 0;
    std::nth_element(first, middle, last, [&](uint32_t a, uint32_t b) {
        if (++compared % POLLED == 0) poll();
        const float left = mean(a)[longest], right = mean(b)[longest];
        return left < right || (left == right && a < b);
    });
    return middle;
}

// A bounding box that grows as points are added.
struct GrowingBox {
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};

    void enclose(const float* point) {
        for (int axis = 0; axis < 3; ++axis) {
            low[axis] = std::min(low[axis], point[axis]);
            high[axis] = std::max(high[axis], point[axis]);
        }
    }

    // Length of the diagonal; 0 while the box is empty.
    double diagonal() const {
        if (low[0] > high[0]) return 0.0;
        return std::hypot(double(high[0]) - low[0], double(high[1]) - low[1], double(high[2]) - low[2]);
    }
};

// Split [first, last) along an axis, at a multiple of `leaf`, into the two parts with the smallest sum of count times
// diagonal, and return the middle. This gives outliers, such as the sky around a yard, a part of their own. Neither
// part has less than a sixteenth of all leaves, which bounds the depth of a tree.
template <class Mean>
uint32_t* split(uint32_t* first, uint32_t* last, size_t leaf, const Mean& mean) {
    constexpr size_t SMALLEST_SHARE = 16;
    const size_t count = size_t(last - first), leaves = (count + leaf - 1) / leaf;
    const size_t fewest = std::max<size_t>(1, leaves / SMALLEST_SHARE);
    std::vector<std::pair<float, uint32_t>> along(count), best;
    std::vector<double> costs(leaves);  // cost of the part before each leaf
    double least = std::numeric_limits<double>::infinity();
    uint32_t* middle = first;
    uint32_t compared = 0;
    for (int axis = 0; axis < 3; ++axis) {
        for (size_t i = 0; i < count; ++i) along[i] = {mean(first[i])[axis], first[i]};
        std::sort(along.begin(), along.end(), [&](const auto& a, const auto& b) {
            if (++compared % POLLED == 0) poll();
            return a < b;
        });
        GrowingBox before, behind;
        for (size_t i = 0; i < count; ++i) {
            if (i % leaf == 0) costs[i / leaf] = double(i) * before.diagonal();
            before.enclose(mean(along[i].second));
        }
        bool better = false;
        for (size_t i = count; i-- > fewest * leaf;) {
            behind.enclose(mean(along[i].second));
            if (i % leaf > 0 || leaves - i / leaf < fewest) continue;
            const double cost = costs[i / leaf] + double(count - i) * behind.diagonal();
            if (cost < least) least = cost, middle = first + i, better = true;
        }
        if (better) best = along;
    }
    for (size_t i = 0; i < count; ++i) first[i] = best[i].second;
    return middle;
}

// Order [first, last) by halving it recursively, down to runs of `leaf`.
template <class Mean>
void order_in_space(uint32_t* first, uint32_t* last, size_t leaf, const Mean& mean) {
    if (size_t(last - first) <= leaf) return;
    uint32_t* middle = halve(first, last, leaf, mean);
    order_in_space(first, middle, leaf, mean);
    order_in_space(middle, last, leaf, mean);
}

}  // namespace splatrl
