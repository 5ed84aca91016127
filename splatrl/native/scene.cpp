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

// Bounds of the Gaussians with the indices [first, last), slightly loose so that rounding never cuts one off.
// `opacities` are the highest that they can reach in an image.
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

// Bounds that enclose both `a` and `b`.
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

// The lower triangle L, row by row, for which L Lᵀ = A Aᵀ: the rows of A expressed in their Gram-Schmidt basis.
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

// Convert merged Gaussians, at most GROUP of them, to half floats.
MergedGroup in_halves(const Levels& levels, size_t first, size_t count) {
    MergedGroup out{};
    std::fill_n(out.log2_opacity, GROUP, to_half(-LARGEST_HALF));  // padding is never visible
    std::vector<std::array<float, 6>> factors(count);
    float largest = 0.0f;
    for (int i = 0; i < 3; ++i) {
        float low = levels.means[3 * first + i], high = low;
        for (size_t k = first; k < first + count; ++k) {
            low = std::min(low, levels.means[3 * k + i]);
            high = std::max(high, levels.means[3 * k + i]);
        }
        out.center[i] = low + 0.5f * (high - low);
        largest = std::max(largest, high - low);
    }
    for (size_t k = 0; k < count; ++k) {
        factors[k] = triangle_of(levels.axes.data() + 9 * (first + k));
        for (float value : factors[k]) largest = std::max(largest, std::fabs(value));
    }
    constexpr int LEAST = -100, OF_HALVES = 15;  // exponents of two; that of the largest half float is 15
    out.scale = std::ldexp(1.0f, largest > 0.0f ? std::max(std::ilogb(largest) + 1 - OF_HALVES, LEAST) : 0);
    const auto scaled = [&out](float value) { return to_half(value / out.scale); };
    for (size_t k = 0; k < count; ++k) {
        const size_t source = first + k;
        for (int i = 0; i < 3; ++i) out.means[i][k] = scaled(levels.means[3 * source + i] - out.center[i]);
        for (int i = 0; i < 6; ++i) out.factor[i][k] = scaled(factors[k][i]);
        if (levels.opacities[source] > 0.0f) out.log2_opacity[k] = to_half(std::log2(levels.opacities[source]));
        out.members[k] = to_half(levels.members[source]);
        out.sums[k] = to_half(levels.sums[source]);
    }
    return out;
}

Stored merged_at(const MergedGroup& group, size_t lane) {
    Stored out{};
    for (int i = 0; i < 3; ++i) out.mean[i] = group.center[i] + from_half(group.means[i][lane]) * group.scale;
    for (int i = 0; i < 6; ++i) out.factor[i] = from_half(group.factor[i][lane]) * group.scale;
    out.log2_opacity = from_half(group.log2_opacity[lane]);
    if (out.log2_opacity == -LARGEST_HALF) out.log2_opacity = NEVER_SHOWS;
    out.members = from_half(group.members[lane]);
    out.sum = from_half(group.sums[lane]);
    return out;
}

}  // namespace

float reach_of(float opacity) {
    const float log2_reach = std::log2(std::max(opacity, 1e-30f)) - LOG2_INVISIBLE_ANTIALIASED;
    return std::sqrt(std::max(0.0f, log2_reach / HALF_LOG2_E));
}

// The square root of the largest eigenvalue of Σ = A Aᵀ, in closed form (Smith 1961).
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

Stored stored(const SceneView& scene, size_t group, size_t lane) {
    if (group >= scene.first_merged) return merged_at(scene.merged[group - scene.first_merged], lane);
    const float* geometry = scene.geometry + group * GEOMETRY * GROUP + lane;
    Stored out{};
    for (int i = 0; i < 3; ++i) out.mean[i] = geometry[(MEAN + i) * GROUP];
    for (int i = 0; i < 6; ++i) out.factor[i] = geometry[(FACTOR + i) * GROUP];
    out.log2_opacity = geometry[LOG2_OPACITY * GROUP];
    return out;
}

Scene::Scene(const GaussianArrays& gaussians, const Levels& levels, std::array<float, 3> background, bool antialiased)
    : background_(background),
      degree_(gaussians.degree),
      clusters_(levels.nodes.size()),
      group_bounds_(levels.nodes.size()) {
    size_t groups = 0, merged_groups = 0;
    for (const Node& node : levels.nodes) (node.leaf ? groups : merged_groups) += groups_of(node);
    const size_t all = groups + merged_groups;
    geometry_ = make_buffer<float>(groups * GEOMETRY * GROUP);
    merged_ = make_buffer<MergedGroup>(merged_groups);
    colors_ = make_buffer<uint16_t>(all * gaussians.colors() * GROUP);
    original_index_ = make_buffer<uint32_t>(all * GROUP);
    std::memset(geometry_.get(), 0, groups * GEOMETRY * GROUP * sizeof(float));
    std::memset(colors_.get(), 0, all * gaussians.colors() * GROUP * sizeof(uint16_t));
    std::memset(original_index_.get(), 0, all * GROUP * sizeof(uint32_t));
    for (size_t i = 0; i < levels.nodes.size(); ++i) {
        const Node& node = levels.nodes[i];
        if (!node.leaf) continue;
        pack(gaussians, levels.order.data(), node);
        add(gaussians, gaussians.opacities, levels.order.data(), 0, node, i);
    }
    first_merged_ = groups_;
    add_merged(levels, gaussians, antialiased);
    enclose(levels.nodes);
    enclose_means();
}

// Add the nodes of merged Gaussians. Their bounds are those of the rounded values that are stored, and the distance by
// which rounding moves a mean adds to the node's error.
void Scene::add_merged(const Levels& levels, const GaussianArrays& gaussians, bool antialiased) {
    const size_t count = levels.opacities.size();
    std::vector<float> means(3 * count), axes(9 * count), most(count);
    std::vector<uint32_t> in_order(count);
    std::iota(in_order.begin(), in_order.end(), 0u);
    const GaussianArrays kept{means.data(), axes.data(), most.data(), levels.sh.data(), count, gaussians.degree};
    for (size_t i = 0; i < levels.nodes.size(); ++i) {
        const Node& node = levels.nodes[i];
        if (node.leaf) continue;
        float moved = 0.0f;
        for (size_t k = 0; k < node.count; ++k) {
            const size_t source = node.first + k;
            MergedGroup& group = merged_[groups_ - first_merged_ + k / GROUP];
            if (k % GROUP == 0) group = in_halves(levels, source, std::min(node.count - k, size_t(GROUP)));
            const Stored item = merged_at(group, k % GROUP);
            std::copy_n(item.mean, 3, &means[3 * source]);
            float apart = 0.0f;
            for (int axis = 0; axis < 3; ++axis)
                apart = std::hypot(apart, item.mean[axis] - levels.means[3 * source + axis]);
            moved = std::max(moved, apart);
            copy_factor(item.factor, &axes[9 * source]);
            most[source] = most_opacity(std::exp2(item.log2_opacity), item.sum, antialiased);
        }
        add(kept, most.data(), in_order.data(), uint32_t(gaussians.count), node, i);
        clusters_[i].error = std::hypot(node.error, moved);
    }
}

Scene::Scene(const SceneView& view, size_t groups)
    : background_{view.background[0], view.background[1], view.background[2]},
      degree_(view.degree),
      groups_(groups),
      first_merged_(view.first_merged),
      geometry_(copied(view.geometry, first_merged_ * GEOMETRY * GROUP)),
      merged_(copied(view.merged, groups - first_merged_)),
      colors_(copied(view.colors, groups * 3 * size_t((view.degree + 1) * (view.degree + 1)) * GROUP)),
      original_index_(copied(view.original_index, groups * GROUP)),
      clusters_(view.clusters, view.clusters + view.cluster_count),
      group_bounds_(view.group_bounds, view.group_bounds + view.cluster_count) {
    enclose_means();
}

// Append the geometry of a node of the scene's own Gaussians, padded to whole groups.
void Scene::pack(const GaussianArrays& gaussians, const uint32_t* order, const Node& node) {
    for (size_t i = 0; i < groups_of(node) * GROUP; ++i) {
        const size_t slot = groups_ * GROUP + i;
        float* geometry = geometry_.get() + slot / GROUP * GEOMETRY * GROUP + slot % GROUP;
        geometry[LOG2_OPACITY * GROUP] = NEVER_SHOWS;  // for the padding of the last group
        if (i >= node.count) continue;
        const size_t source = order[node.first + i];
        for (int k = 0; k < 3; ++k) geometry[(MEAN + k) * GROUP] = gaussians.means[3 * source + k];
        const std::array<float, 6> factor = triangle_of(gaussians.axes + 9 * source);
        for (int k = 0; k < 6; ++k) geometry[(FACTOR + k) * GROUP] = factor[k];
        if (gaussians.opacities[source] > 0.0f)
            geometry[LOG2_OPACITY * GROUP] = std::log2(gaussians.opacities[source]);
    }
}

// Append everything of a node but its geometry, which the groups from `groups_` on already hold. `opacities` are the
// highest that its Gaussians can reach in an image.
void Scene::add(const GaussianArrays& gaussians, const float* opacities, const uint32_t* order, uint32_t first_index,
                const Node& node, size_t index) {
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
    for (size_t i = 0; i < node.count; ++i) {
        const size_t slot = groups_ * GROUP + i, source = first[i];
        original_index_[slot] = first_index + uint32_t(source);
        uint16_t* colors = colors_.get() + slot / GROUP * values * GROUP + slot % GROUP;
        const float* sh = gaussians.sh + values * source;
        for (size_t k = 0; k < values; ++k)
            colors[k * GROUP] = to_half(degree_ > 0 ? sh[k] : std::max(SH_C0 * sh[k] + 0.5f, 0.0f) - background_[k]);
    }
    groups_ += cluster.groups;
}

// Extend the bounds of inner nodes to everything below them.
void Scene::enclose(const std::vector<Node>& nodes) {
    for (size_t i = clusters_.size(); i-- > 0;) {
        if (nodes[i].leaf) continue;
        const size_t second = nodes[i + 1].skip;
        Bounds below = clusters_[i + 1].bounds;
        if (second < nodes[i].skip) below = both(below, clusters_[second].bounds);
        clusters_[i].bounds = nodes[i].count > 0 ? both(below, clusters_[i].bounds) : below;
    }
}

// Compute the box around the means that each node shows.
void Scene::enclose_means() {
    boxes_.resize(clusters_.size());
    const SceneView scene = view(0.0f);
    for (size_t i = 0; i < clusters_.size(); ++i) {
        float low[3], high[3];
        std::fill_n(low, 3, std::numeric_limits<float>::max());
        std::fill_n(high, 3, std::numeric_limits<float>::lowest());
        for (uint32_t group = 0; group < clusters_[i].groups; ++group) {
            for (int lane = 0; lane < GROUP; ++lane) {
                const Stored item = stored(scene, clusters_[i].first_group + group, lane);
                if (item.log2_opacity == NEVER_SHOWS) continue;
                for (int axis = 0; axis < 3; ++axis) {
                    low[axis] = std::min(low[axis], item.mean[axis]);
                    high[axis] = std::max(high[axis], item.mean[axis]);
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
            merged_.get(),
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
