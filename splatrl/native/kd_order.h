// Orders points so that neighbours in memory are neighbours in space, at every scale.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "threads.h"

namespace splatrl {

constexpr uint32_t POLLED = 1u << 16;  // comparisons between two polls

// Halve [first, last) along its longest axis, at a multiple of `leaf`, and return the middle. `mean` gives the three
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

// Order [first, last) by halving it until runs of `leaf` are left.
template <class Mean>
void order_in_space(uint32_t* first, uint32_t* last, size_t leaf, const Mean& mean) {
    if (size_t(last - first) <= leaf) return;
    uint32_t* middle = halve(first, last, leaf, mean);
    order_in_space(first, middle, leaf, mean);
    order_in_space(middle, last, leaf, mean);
}

}  // namespace splatrl
