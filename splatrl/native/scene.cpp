#include "scene.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>

#include "half.h"
#include "threads.h"

namespace splatrl {

namespace {

size_t groups_of(const Node& node) { return (node.count + GROUP - 1) / GROUP; }

// Bounds of the Gaussians that [first, last) name, slightly loose so that rounding never cuts one off. `opacities` are
// the most that they can have on an image.
Bounds bounds_of(const GaussianArrays& gaussians, const float* opacities, const uint32_t* first, const uint32_t* last) {
    Bounds bounds{};
    float low[3], high[3];
    std::copy_n(gaussians.means + 3 * size_t(*first), 3, low);
    std::copy_n(gaussians.means + 3 * size_t(*first), 3, high);
    for (const uint32_t* item = first; item != last; ++item) {
        const float *mean = gaussians.means + 3 * size_t(*item), *axes = gaussians.axes + 9 * size_t(*item);
        for (int i = 0; i < 3; ++i) {
            low[i] = std::min(low[i], mean[i]);
            high[i] = std::max(high[i], mean[i]);
        }
        const float reach = reach_of(opacities[*item]);
        bounds.reach = std::max(bounds.reach, reach);
        bounds.reach_scale = std::max(bounds.reach_scale, reach * longest_axis(axes));
    }
    for (int i = 0; i < 3; ++i) bounds.center[i] = 0.5f * (low[i] + high[i]);
    for (const uint32_t* item = first; item != last; ++item) {
        float distance = 0.0f;
        const float* mean = gaussians.means + 3 * size_t(*item);
        for (int i = 0; i < 3; ++i) distance = std::hypot(distance, mean[i] - bounds.center[i]);
        bounds.radius = std::max(bounds.radius, distance * 1.00001f);
    }
    return bounds;
}

// Bounds of everything within `a` and `b`.
Bounds both(const Bounds& a, const Bounds& b) {
    float apart = 0.0f;
    for (int i = 0; i < 3; ++i) apart = std::hypot(apart, b.center[i] - a.center[i]);
    Bounds out = a.radius >= apart + b.radius ? a : b;
    if (a.radius < apart + b.radius && b.radius < apart + a.radius) {
        out.radius = 0.5f * (apart + a.radius + b.radius);
        for (int i = 0; i < 3; ++i)
            out.center[i] = a.center[i] + (b.center[i] - a.center[i]) * ((out.radius - a.radius) / apart);
        out.radius *= 1.00001f;
    }
    out.reach = std::max(a.reach, b.reach);
    out.reach_scale = std::max(a.reach_scale, b.reach_scale);
    return out;
}

double dot(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

template <class T>
Buffer<T> copied(const T* values, size_t count) {
    Buffer<T> buffer = make_buffer<T>(count);
    std::copy_n(values, count, buffer.get());
    return buffer;
}

// The lower triangle L, row by row, for which L Lᵀ = A Aᵀ: the rows of A in the axes of Gram and Schmidt.
std::array<float, 6> triangle_of(const float* axes) {
    double rows[3][3];
    std::copy_n(axes, 9, rows[0]);
    std::array<float, 6> out{};
    for (int axis = 0; axis < 3; ++axis) {
        const double* along = rows[axis];
        const double length = std::sqrt(dot(along, along));
        out[axis * (axis + 1) / 2 + axis] = float(length);
        for (int row = axis + 1; row < 3 && length > 0.0; ++row) {
            const double part = dot(rows[row], along) / length;
            out[row * (row + 1) / 2 + axis] = float(part);
            for (int i = 0; i < 3; ++i) rows[row][i] -= part / length * along[i];
        }
    }
    return out;
}

}  // namespace

float reach_of(float opacity) {
    const float log2_reach = std::log2(std::max(opacity, 1e-30f)) - LOG2_INVISIBLE_ANTIALIASED;
    return std::sqrt(std::max(0.0f, log2_reach / HALF_LOG2_E));
}

// The root of the largest eigenvalue of Σ = A Aᵀ, in closed form (Smith 1961).
float longest_axis(const float* axes) {
    double m[3][3];
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k)
            m[i][k] = double(axes[3 * i]) * axes[3 * k] + double(axes[3 * i + 1]) * axes[3 * k + 1] +
                      double(axes[3 * i + 2]) * axes[3 * k + 2];
    const double mean = (m[0][0] + m[1][1] + m[2][2]) / 3.0;
    for (int i = 0; i < 3; ++i) m[i][i] -= mean;
    double squares = 0.0;
    for (const auto& row : m)
        for (double value : row) squares += value * value;
    const double spread = std::sqrt(squares / 6.0);
    double largest = mean;
    if (spread > 0.0) {
        for (auto& row : m)
            for (double& value : row) value /= spread;
        const double determinant = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) -
                                   m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
                                   m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
        largest += 2.0 * spread * std::cos(std::acos(std::clamp(determinant / 2.0, -1.0, 1.0)) / 3.0);
    }
    return float(std::sqrt(largest)) * 1.00001f;
}

Scene::Scene(const GaussianArrays& gaussians, const Levels& levels, std::array<float, 3> background, bool antialiased)
    : background_(background),
      degree_(gaussians.degree),
      clusters_(levels.nodes.size()),
      group_bounds_(levels.nodes.size()) {
    size_t groups = 0, merged_groups = 0;
    for (const Node& node : levels.nodes) (node.leaf ? groups : merged_groups) += groups_of(node);
    const size_t all = groups + merged_groups;
    geometry_ = make_buffer<float>(all * GEOMETRY * GROUP);
    merging_ = make_buffer<float>(merged_groups * MERGING * GROUP);
    colors_ = make_buffer<uint16_t>(all * gaussians.colors() * GROUP);
    original_index_ = make_buffer<uint32_t>(all * GROUP);
    std::memset(geometry_.get(), 0, all * GEOMETRY * GROUP * sizeof(float));
    std::memset(merging_.get(), 0, merged_groups * MERGING * GROUP * sizeof(float));
    std::memset(colors_.get(), 0, all * gaussians.colors() * GROUP * sizeof(uint16_t));
    std::memset(original_index_.get(), 0, all * GROUP * sizeof(uint32_t));

    const GaussianArrays merged{levels.means.data(), levels.axes.data(),      levels.opacities.data(),
                                levels.sh.data(),    levels.opacities.size(), gaussians.degree};
    std::vector<uint32_t> in_order(merged.count);
    std::iota(in_order.begin(), in_order.end(), 0u);
    for (size_t i = 0; i < levels.nodes.size(); ++i)
        if (levels.nodes[i].leaf) pack(gaussians, gaussians.opacities, levels.order.data(), levels.nodes[i], i);
    first_merged_ = groups_;
    std::vector<float> most(levels.opacities);
    poll();
    for (size_t i = 0; i < most.size(); ++i) most[i] = most_opacity(levels.opacities[i], levels.sums[i], antialiased);
    for (size_t i = 0; i < levels.nodes.size(); ++i) {
        const Node& node = levels.nodes[i];
        if (node.leaf) continue;
        pack(merged, most.data(), in_order.data(), node, i);
        for (size_t k = 0; k < node.count; ++k) {
            const size_t slot = size_t(clusters_[i].first_group - first_merged_) * GROUP + k;
            float* merging = merging_.get() + slot / GROUP * MERGING * GROUP + slot % GROUP;
            merging[MEMBERS * GROUP] = levels.members[node.first + k];
            merging[SUM * GROUP] = levels.sums[node.first + k];
            original_index_[first_merged_ * GROUP + slot] = uint32_t(gaussians.count) + node.first + uint32_t(k);
        }
    }
    enclose(levels.nodes);
    enclose_means();
}

Scene::Scene(const SceneView& view, size_t groups)
    : background_{view.background[0], view.background[1], view.background[2]},
      degree_(view.degree),
      groups_(groups),
      first_merged_(view.first_merged),
      geometry_(copied(view.geometry, groups * GEOMETRY * GROUP)),
      merging_(copied(view.merging, (groups - view.first_merged) * MERGING * GROUP)),
      colors_(copied(view.colors, groups * 3 * size_t((view.degree + 1) * (view.degree + 1)) * GROUP)),
      original_index_(copied(view.original_index, groups * GROUP)),
      clusters_(view.clusters, view.clusters + view.cluster_count),
      group_bounds_(view.group_bounds, view.group_bounds + view.cluster_count) {
    enclose_means();
}

// Append the Gaussians of a node, in whole groups.
void Scene::pack(const GaussianArrays& gaussians, const float* opacities, const uint32_t* order, const Node& node,
                 size_t index) {
    poll();
    Cluster& cluster = clusters_[index];
    cluster = {{}, node.error, uint32_t(groups_), uint32_t(groups_of(node)), node.skip};
    const uint32_t *first = order + node.first, *last = first + node.count;
    if (node.count > 0) cluster.bounds = bounds_of(gaussians, opacities, first, last);
    for (size_t group = 0; group < cluster.groups; ++group) {
        const uint32_t* begin = first + group * GROUP;
        const Bounds bounds = bounds_of(gaussians, opacities, begin, std::min(last, begin + GROUP));
        const float members[6] = {bounds.center[0], bounds.center[1], bounds.center[2],
                                  bounds.radius,    bounds.reach,     bounds.reach_scale};
        for (int i = 0; i < 6; ++i) group_bounds_[index].members[i][group] = members[i];
    }
    const size_t values = gaussians.colors();
    for (size_t i = 0; i < cluster.groups * GROUP; ++i) {
        const size_t slot = groups_ * GROUP + i;
        float* geometry = geometry_.get() + slot / GROUP * GEOMETRY * GROUP + slot % GROUP;
        geometry[LOG2_OPACITY * GROUP] = std::numeric_limits<float>::lowest();  // padding of the last group never shows
        if (i >= node.count) continue;
        const size_t source = first[i];
        original_index_[slot] = uint32_t(source);
        for (int k = 0; k < 3; ++k) geometry[(MEAN + k) * GROUP] = gaussians.means[3 * source + k];
        const std::array<float, 6> factor = triangle_of(gaussians.axes + 9 * source);
        for (int k = 0; k < 6; ++k) geometry[(FACTOR + k) * GROUP] = factor[k];
        if (gaussians.opacities[source] > 0.0f)
            geometry[LOG2_OPACITY * GROUP] = std::log2(gaussians.opacities[source]);
        uint16_t* colors = colors_.get() + slot / GROUP * values * GROUP + slot % GROUP;
        const float* sh = gaussians.sh + values * source;
        for (size_t k = 0; k < values; ++k)
            colors[k * GROUP] = to_half(degree_ > 0 ? sh[k] : std::max(SH_C0 * sh[k] + 0.5f, 0.0f) - background_[k]);
    }
    groups_ += cluster.groups;
}

// Let inner nodes bound all below them.
void Scene::enclose(const std::vector<Node>& nodes) {
    for (size_t i = clusters_.size(); i-- > 0;) {
        if (nodes[i].leaf) continue;
        const size_t second = nodes[i + 1].skip;
        Bounds below = clusters_[i + 1].bounds;
        if (second < nodes[i].skip) below = both(below, clusters_[second].bounds);
        clusters_[i].bounds = nodes[i].count > 0 ? both(below, clusters_[i].bounds) : below;
    }
}

// The boxes around what each node shows.
void Scene::enclose_means() {
    boxes_.resize(clusters_.size());
    for (size_t i = 0; i < clusters_.size(); ++i) {
        float low[3], high[3];
        std::fill_n(low, 3, std::numeric_limits<float>::max());
        std::fill_n(high, 3, std::numeric_limits<float>::lowest());
        for (uint32_t group = 0; group < clusters_[i].groups; ++group) {
            const float* geometry = geometry_.get() + size_t(clusters_[i].first_group + group) * GEOMETRY * GROUP;
            for (int lane = 0; lane < GROUP; ++lane) {
                if (geometry[LOG2_OPACITY * GROUP + lane] == std::numeric_limits<float>::lowest()) continue;
                for (int axis = 0; axis < 3; ++axis) {
                    low[axis] = std::min(low[axis], geometry[axis * GROUP + lane]);
                    high[axis] = std::max(high[axis], geometry[axis * GROUP + lane]);
                }
            }
        }
        for (int axis = 0; axis < 3; ++axis) {
            boxes_[i].center[axis] = 0.5f * (low[axis] + high[axis]);
            boxes_[i].half[axis] = 0.5f * (high[axis] - low[axis]);
        }
    }
}

SceneView Scene::view(float tolerance) const {
    return {geometry_.get(),
            merging_.get(),
            colors_.get(),
            original_index_.get(),
            clusters_.data(),
            group_bounds_.data(),
            boxes_.data(),
            uint32_t(clusters_.size()),
            uint32_t(first_merged_),
            degree_,
            {background_[0], background_[1], background_[2]},
            tolerance};
}

}  // namespace splatrl
