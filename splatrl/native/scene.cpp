#include "scene.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>

namespace splatrl {

namespace {

// Order [first, last) by halving it along its longest axis, at multiples of `leaf`, until a leaf is left: runs of
// `leaf` neighbours in memory are neighbours in space, at every scale.
void order_in_space(const float* means, uint32_t* first, uint32_t* last, size_t leaf) {
    const size_t count = size_t(last - first);
    if (count <= leaf) return;
    float low[3], high[3];
    std::copy_n(means + 3 * size_t(*first), 3, low);
    std::copy_n(means + 3 * size_t(*first), 3, high);
    for (const uint32_t* item = first; item != last; ++item)
        for (int axis = 0; axis < 3; ++axis) {
            const float value = means[3 * size_t(*item) + axis];
            low[axis] = std::min(low[axis], value);
            high[axis] = std::max(high[axis], value);
        }
    int longest = 0;
    for (int axis = 1; axis < 3; ++axis)
        if (high[axis] - low[axis] > high[longest] - low[longest]) longest = axis;
    const size_t leaves = (count + leaf - 1) / leaf;
    uint32_t* middle = first + (leaves + 1) / 2 * leaf;
    std::nth_element(first, middle, last, [&](uint32_t a, uint32_t b) {
        const float left = means[3 * size_t(a) + longest], right = means[3 * size_t(b) + longest];
        return left < right || (left == right && a < b);
    });
    order_in_space(means, first, middle, leaf);
    order_in_space(means, middle, last, leaf);
}

// The nearest half float; what is larger becomes the largest.
uint16_t to_half(float value) {
    const float bounded = std::min(std::fabs(value), 65504.0f) * 1.925929944387236e-34f;  // 2^-112
    uint32_t bits;
    std::memcpy(&bits, &bounded, sizeof(bits));
    return uint16_t(((bits + 0xfff + ((bits >> 13) & 1)) >> 13) | (std::signbit(value) ? 0x8000 : 0));
}

float reach_of(float opacity) { return std::sqrt(std::max(0.0f, 2.0f * std::log(255.0f * opacity))); }

}  // namespace

Scene::Scene(const float* means, const float* axes, const float* opacities, const float* sh, size_t count, int degree,
             std::array<float, 3> background)
    : count_(count),
      groups_((count + GROUP - 1) / GROUP),
      degree_(degree),
      background_(background),
      geometry_(make_buffer<float>(groups_ * GEOMETRY * GROUP)),
      colors_(make_buffer<uint16_t>(groups_ * 3 * size_t((degree + 1) * (degree + 1)) * GROUP)),
      original_index_(make_buffer<uint32_t>(groups_ * GROUP)) {
    std::vector<uint32_t> order(count);
    std::iota(order.begin(), order.end(), 0u);
    for (const size_t leaf : {size_t(CLUSTER), size_t(GROUP)})
        for (size_t first = 0; first < count; first += leaf == CLUSTER ? count : CLUSTER) {
            const size_t last = leaf == CLUSTER ? count : std::min(count, first + CLUSTER);
            order_in_space(means, order.data() + first, order.data() + last, leaf);
        }
    pack(means, axes, opacities, sh, order);
    bound(means, axes, opacities, order);
}

void Scene::pack(const float* means, const float* axes, const float* opacities, const float* sh,
                 const std::vector<uint32_t>& order) {
    const size_t values = 3 * size_t((degree_ + 1) * (degree_ + 1));
    std::memset(geometry_.get(), 0, groups_ * GEOMETRY * GROUP * sizeof(float));
    std::memset(colors_.get(), 0, groups_ * values * GROUP * sizeof(uint16_t));
    std::memset(original_index_.get(), 0, groups_ * GROUP * sizeof(uint32_t));
    for (size_t slot = 0; slot < groups_ * GROUP; ++slot) {
        float* geometry = geometry_.get() + slot / GROUP * GEOMETRY * GROUP + slot % GROUP;
        geometry[LOG2_OPACITY * GROUP] = std::numeric_limits<float>::lowest();  // what pads the last group never shows
        if (slot >= count_) continue;
        const size_t source = order[slot];
        original_index_[slot] = order[slot];
        for (int i = 0; i < 3; ++i) geometry[(MEAN + i) * GROUP] = means[3 * source + i];
        for (int i = 0; i < 9; ++i) geometry[(AXES + i) * GROUP] = axes[9 * source + i];
        if (opacities[source] > 0.0f) geometry[LOG2_OPACITY * GROUP] = std::log2(opacities[source]);
        uint16_t* colors = colors_.get() + slot / GROUP * values * GROUP + slot % GROUP;
        for (size_t i = 0; i < values; ++i) colors[i * GROUP] = to_half(sh[values * source + i]);
        if (degree_ == 0)
            for (size_t i = 0; i < 3; ++i)
                colors[i * GROUP] = to_half(std::max(SH_C0 * sh[3 * source + i] + 0.5f, 0.0f) - background_[i]);
    }
}

namespace {

// Bounds of the Gaussians that [first, last) name, a little loose so that no rounding cuts one off.
Bounds bounds_of(const float* means, const float* axes, const float* opacities, const uint32_t* first,
                 const uint32_t* last) {
    Bounds bounds{};
    float low[3], high[3];
    std::copy_n(means + 3 * size_t(*first), 3, low);
    std::copy_n(means + 3 * size_t(*first), 3, high);
    for (const uint32_t* item = first; item != last; ++item) {
        const size_t source = *item;
        float squared = 0.0f;  // of the longest axis
        for (int i = 0; i < 3; ++i) {
            low[i] = std::min(low[i], means[3 * source + i]);
            high[i] = std::max(high[i], means[3 * source + i]);
        }
        for (int axis = 0; axis < 3; ++axis) {
            float length = 0.0f;
            for (int i = 0; i < 3; ++i) length += axes[9 * source + 3 * i + axis] * axes[9 * source + 3 * i + axis];
            squared = std::max(squared, length);
        }
        const float reach = reach_of(opacities[source]);
        bounds.reach = std::max(bounds.reach, reach);
        bounds.reach_scale = std::max(bounds.reach_scale, reach * std::sqrt(squared));
    }
    for (int i = 0; i < 3; ++i) bounds.center[i] = 0.5f * (low[i] + high[i]);
    for (const uint32_t* item = first; item != last; ++item) {
        float distance = 0.0f;
        const float* mean = means + 3 * size_t(*item);
        for (int i = 0; i < 3; ++i) distance = std::hypot(distance, mean[i] - bounds.center[i]);
        bounds.radius = std::max(bounds.radius, distance * 1.00001f);
    }
    return bounds;
}

}  // namespace

void Scene::bound(const float* means, const float* axes, const float* opacities, const std::vector<uint32_t>& order) {
    for (size_t first = 0; first < count_; first += CLUSTER) {
        const size_t last = std::min(count_, first + CLUSTER);
        Cluster cluster{};
        cluster.first_group = uint32_t(first / GROUP);
        cluster.groups = uint32_t((last - first + GROUP - 1) / GROUP);
        cluster.bounds = bounds_of(means, axes, opacities, &order[first], &order[first] + (last - first));
        for (uint32_t group = 0; group < cluster.groups; ++group) {
            const size_t begin = first + group * GROUP, end = std::min(last, begin + GROUP);
            const Bounds bounds = bounds_of(means, axes, opacities, &order[begin], &order[begin] + (end - begin));
            const float values[6] = {bounds.center[0], bounds.center[1], bounds.center[2],
                                     bounds.radius,    bounds.reach,     bounds.reach_scale};
            for (int i = 0; i < 6; ++i) cluster.groups_bounds[i][group] = values[i];
        }
        clusters_.push_back(cluster);
    }
}

SceneView Scene::view() const {
    return {geometry_.get(),  colors_.get(), original_index_.get(), clusters_.data(), uint32_t(clusters_.size()),
            degree_,         {background_[0], background_[1], background_[2]}};
}

}  // namespace splatrl
