#include "packed.h"

#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "bindings.h"
#include "interpreter.h"
#include "levels_binding.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

template <class T>
std::vector<T> values_of(const T* values, size_t count) {
    return std::vector<T>(values, values + count);
}

// The kernels follow these indices unchecked, so reject any that lead outside the arrays.
bool is_sound(const std::vector<Cluster>& clusters, size_t groups) {
    for (size_t i = 0; i < clusters.size(); ++i) {
        const Cluster& cluster = clusters[i];
        const bool shows = cluster.groups > 0 && cluster.groups <= GROUP;
        const bool inside = size_t(cluster.first_group) + cluster.groups <= groups;
        const bool forward = cluster.skip > i && cluster.skip <= clusters.size();
        const bool opens = cluster.error == 0.0f ? cluster.skip == i + 1 : i + 1 < cluster.skip;
        if (!(cluster.error >= 0.0f) || !inside || !forward || !opens || !(shows || std::isinf(cluster.error)))
            return false;
    }
    return true;
}

}  // namespace

nb::dict to_arrays(const Scene& scene) {
    const SceneView view = scene.view(0.0f);
    const size_t groups = scene.groups(), merged = groups - view.first_merged, nodes = view.cluster_count;
    const size_t channels = 3 * size_t((view.degree + 1) * (view.degree + 1));
    std::vector<float> bounds, errors, group_bounds;
    std::vector<uint32_t> table;
    for (size_t i = 0; i < nodes; ++i) {
        const Cluster& c = view.clusters[i];
        bounds.insert(bounds.end(), {c.bounds.center[0], c.bounds.center[1], c.bounds.center[2], c.bounds.radius,
                                     c.bounds.reach, c.bounds.reach_scale});
        errors.push_back(c.error);
        table.insert(table.end(), {c.first_group, c.groups, c.skip});
        const float* members = view.group_bounds[i].members[0];
        group_bounds.insert(group_bounds.end(), members, members + 6 * GROUP);
    }
    nb::dict out;
    out["nodes"] = to_numpy(std::move(table), {nodes, 3});
    out["errors"] = to_numpy(std::move(errors), {nodes});
    out["bounds"] = to_numpy(std::move(bounds), {nodes, 6});
    out["group_bounds"] = to_numpy(std::move(group_bounds), {nodes, 6, size_t(GROUP)});
    out["geometry"] = to_numpy(values_of(view.geometry, view.first_merged * GEOMETRY * GROUP),
                               {size_t(view.first_merged), size_t(GEOMETRY), size_t(GROUP)});
    const auto* records = reinterpret_cast<const uint8_t*>(view.merged);
    out["merged"] = to_numpy(values_of(records, merged * sizeof(MergedGroup)), {merged, sizeof(MergedGroup)});
    out["colors"] = to_numpy(values_of(view.colors, groups * channels * GROUP), {groups, channels, size_t(GROUP)});
    out["indices"] = to_numpy(values_of(view.original_index, groups * GROUP), {groups, size_t(GROUP)});
    return out;
}

Scene from_arrays(const nb::dict& arrays, std::array<float, 3> background) {
    const auto nodes = nb::cast<Tensor<const uint32_t, -1, 3>>(arrays["nodes"]);
    const auto errors = nb::cast<Tensor<const float, -1>>(arrays["errors"]);
    const auto bounds = nb::cast<Tensor<const float, -1, 6>>(arrays["bounds"]);
    const auto group_bounds = nb::cast<Tensor<const float, -1, 6, GROUP>>(arrays["group_bounds"]);
    const auto geometry = nb::cast<Tensor<const float, -1, GEOMETRY, GROUP>>(arrays["geometry"]);
    const auto merged = nb::cast<Tensor<const uint8_t, -1, sizeof(MergedGroup)>>(arrays["merged"]);
    const auto colors = nb::cast<Tensor<const uint16_t, -1, -1, GROUP>>(arrays["colors"]);
    const auto indices = nb::cast<Tensor<const uint32_t, -1, GROUP>>(arrays["indices"]);
    const size_t count = nodes.shape(0), own = geometry.shape(0), groups = own + merged.shape(0);
    int degree = 0;
    while (degree < 3 && 3 * size_t((degree + 1) * (degree + 1)) < colors.shape(1)) ++degree;
    std::vector<Cluster> clusters(count);
    std::vector<GroupBounds> of_groups(count);
    bool right = errors.shape(0) == count && bounds.shape(0) == count && group_bounds.shape(0) == count &&
                 colors.shape(0) == groups && indices.shape(0) == groups &&
                 colors.shape(1) == 3 * size_t((degree + 1) * (degree + 1));
    for (size_t i = 0; i < count && right; ++i) {
        const uint32_t* node = nodes.data() + 3 * i;
        const float* b = bounds.data() + 6 * i;
        clusters[i] = {{{b[0], b[1], b[2]}, b[3], b[4], b[5]}, errors.data()[i], node[0], node[1], node[2]};
        std::copy_n(group_bounds.data() + 6 * GROUP * i, 6 * GROUP, of_groups[i].members[0]);
    }
    if (!right || !is_sound(clusters, groups))
        throw std::invalid_argument("packed model: expected arrays that pack_model has made");
    SceneView view{};
    view.geometry = geometry.data();
    view.merged = reinterpret_cast<const MergedGroup*>(merged.data());
    view.colors = colors.data();
    view.original_index = indices.data();
    view.clusters = clusters.data();
    view.group_bounds = of_groups.data();
    view.cluster_count = uint32_t(count);
    view.first_merged = uint32_t(own);
    view.degree = degree;
    std::copy_n(background.data(), 3, view.background);
    return Scene(view, groups);
}

void bind_packed(nb::module_& m) {
    m.def(
        "pack_model",
        [](Tensor<const float, -1, 3> means, Tensor<const float, -1, 3, 3> axes, Tensor<const float, -1> opacities,
           Tensor<const float, -1, -1, 3> sh, int degree, std::optional<nb::dict> levels,
           std::array<float, 3> background, bool antialiased) {
            const GaussianArrays gaussians{means.data(), axes.data(), opacities.data(), sh.data(), means.shape(0),
                                           degree};
            const Levels tree = levels ? levels_of(*levels, gaussians) : build_levels(gaussians, CLUSTER, GROUP, false);
            return to_arrays(Scene(gaussians, tree, background, antialiased));
        },
        nb::arg("means"), nb::arg("axes"), nb::arg("opacities"), nb::arg("sh"), nb::arg("degree"),
        nb::arg("levels").none(), nb::arg("background"), nb::arg("antialiased"));
}

}  // namespace splatrl
