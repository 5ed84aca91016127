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

float reach_of(float opacity) { return std::sqrt(std::max(0.0f, 2.0f * std::log(255.0f * opacity))); }

}  // namespace

Scene::Scene(const float* means, const float* axes, const float* opacities, const float* sh, size_t count, int degree)
    : count_(count),
      groups_((count + GROUP - 1) / GROUP),
      degree_(degree),
      geometry_(make_buffer<float>(groups_ * GEOMETRY * GROUP)),
      colors_(make_buffer<float>(groups_ * 3 * size_t((degree + 1) * (degree + 1)) * GROUP)),
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
    std::memset(colors_.get(), 0, groups_ * values * GROUP * sizeof(float));
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
        float* colors = colors_.get() + slot / GROUP * values * GROUP + slot % GROUP;
        for (size_t i = 0; i < values; ++i) colors[i * GROUP] = sh[values * source + i];
        if (degree_ == 0)
            for (size_t i = 0; i < 3; ++i)
                colors[i * GROUP] = std::max(SH_C0 * sh[3 * source + i] + 0.5f, 0.0f);
    }
}

void Scene::bound(const float* means, const float* axes, const float* opacities, const std::vector<uint32_t>& order) {
    for (size_t first = 0; first < count_; first += CLUSTER) {
        const size_t last = std::min(count_, first + CLUSTER);
        Cluster cluster{};
        cluster.first_group = uint32_t(first / GROUP);
        cluster.groups = uint32_t((last - first + GROUP - 1) / GROUP);
        float low[3], high[3];
        std::copy_n(means + 3 * size_t(order[first]), 3, low);
        std::copy_n(means + 3 * size_t(order[first]), 3, high);
        for (size_t slot = first; slot < last; ++slot) {
            const size_t source = order[slot];
            float squared = 0.0f;  // of all axes: at least the longest
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
            cluster.reach = std::max(cluster.reach, reach);
            cluster.reach_scale = std::max(cluster.reach_scale, reach * std::sqrt(squared));
        }
        for (int i = 0; i < 3; ++i) cluster.center[i] = 0.5f * (low[i] + high[i]);
        for (size_t slot = first; slot < last; ++slot) {
            float distance = 0.0f;
            const float* mean = means + 3 * size_t(order[slot]);
            for (int i = 0; i < 3; ++i) distance = std::hypot(distance, mean[i] - cluster.center[i]);
            cluster.radius = std::max(cluster.radius, distance * 1.00001f);
        }
        clusters_.push_back(cluster);
    }
}

SceneView Scene::view() const {
    return {geometry_.get(),  colors_.get(), original_index_.get(), clusters_.data(), uint32_t(clusters_.size()),
            degree_};
}

}  // namespace splatrl
