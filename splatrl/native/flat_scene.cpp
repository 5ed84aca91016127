// A scene as CUDA reads it: what tests need by slot, in the order of the tree; what blending needs by index, which is what
// sorted keys hold.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "arrays.h"
#include "bindings.h"
#include "flat_scene.h"
#include "half.h"
#include "levels_binding.h"
#include "scene.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

// The bits of a half float that is at least this value.
uint16_t half_above(float value) {
    const uint16_t half = to_half(value);
    return from_half(half) < value && half < to_half(LARGEST_HALF) ? half + 1 : half;
}

struct FlatScene {
    bool antialiased;
    std::vector<float> spheres, shapes;
    std::vector<uint16_t> colors;
    std::vector<uint32_t> indices;

    FlatScene(const SceneView& view, size_t capacity, size_t gaussians, bool antialiased)
        : antialiased(antialiased), spheres(capacity * SPHERE), shapes(gaussians * SHAPE),
          colors(gaussians * color_stride(view.degree)), indices(capacity) {
        for (size_t slot = 0; slot < capacity; ++slot) {
            if (slot % 4096 == 0) poll();
            add(view, slot);
        }
    }

private:
    void add(const SceneView& view, size_t slot) {
        const size_t group = slot / GROUP, lane = slot % GROUP;
        const Stored item = stored(view, group, lane);
        float* sphere = &spheres[slot * SPHERE];
        std::copy_n(item.mean, 3, sphere);
        if (item.log2_opacity == NEVER_SHOWS) return;
        const size_t index = indices[slot] = view.original_index[slot];
        float *shape = &shapes[index * SHAPE], axes[9] = {};
        std::copy_n(item.mean, 3, shape);
        std::copy_n(item.factor, 6, shape + 4);
        copy_factor(item.factor, axes);
        float opacity = std::exp2(item.log2_opacity);
        shape[3] = item.log2_opacity;
        shape[10] = item.members;
        shape[11] = item.sum;
        if (group >= view.first_merged) opacity = most_opacity(opacity, item.sum, antialiased);
        const float reach = reach_of(opacity);
        const uint32_t reaches = half_above(reach) | uint32_t(half_above(reach * longest_axis(axes))) << 16;
        std::memcpy(&sphere[3], &reaches, sizeof(reaches));
        const size_t values = 3 * size_t(harmonics_of(view.degree));
        const uint16_t* color = view.colors + group * values * GROUP + lane;
        for (size_t i = 0; i < values; ++i) colors[index * color_stride(view.degree) + i] = color[i * GROUP];
    }
};

template <class T>
nb::ndarray<nb::numpy, uint8_t> bytes_of(const T* items, size_t count) {
    std::vector<uint8_t> bytes(count * sizeof(T));
    std::memcpy(bytes.data(), items, bytes.size());
    return to_numpy(std::move(bytes), {count, sizeof(T)});
}

// The clusters of a tree, renumbered to follow those of other trees.
std::vector<Cluster> clusters_behind(const SceneView& view, uint32_t first_slot, uint32_t first_cluster) {
    std::vector<Cluster> clusters(view.clusters, view.clusters + view.cluster_count);
    for (Cluster& cluster : clusters) cluster.first_group += first_slot / GROUP, cluster.skip += first_cluster;
    return clusters;
}

nb::dict flat_scene(Tensor<const float, -1, 3> means, Tensor<const float, -1, 3, 3> axes,
                    Tensor<const float, -1> opacities, Tensor<const float, -1, -1, 3> sh, int degree,
                    std::array<float, 3> background, std::optional<nb::dict> levels, bool antialiased,
                    float tolerance, uint32_t first_slot, uint32_t first_cluster) {
    const GaussianArrays gaussians{means.data(), axes.data(), opacities.data(), sh.data(), means.shape(0), degree};
    const Levels tree = levels ? levels_of(*levels, gaussians) : build_levels(gaussians, CLUSTER, GROUP, false);
    const Scene scene(gaussians, tree, background, antialiased);
    const SceneView view = scene.view(0.0f);
    const size_t capacity = scene.capacity();
    const size_t all = gaussians.count + tree.opacities.size();
    FlatScene flat(view, capacity, all, antialiased);
    const std::vector<Cluster> clusters = clusters_behind(view, first_slot, first_cluster);
    nb::dict out;
    out["spheres"] = to_numpy(std::move(flat.spheres), {capacity, size_t(SPHERE)});
    out["shapes"] = to_numpy(std::move(flat.shapes), {all, size_t(SHAPE)});
    out["colors"] = to_numpy(std::move(flat.colors), {all, size_t(color_stride(degree))});
    out["indices"] = to_numpy(std::move(flat.indices), {capacity});
    out["tolerance"] = held_tolerance(tolerance, antialiased);
    out["clusters"] = bytes_of(clusters.data(), clusters.size());
    out["group_bounds"] = bytes_of(view.group_bounds, view.cluster_count);
    return out;
}

}  // namespace

void bind_flat_scene(nb::module_& m) {
    m.def("flat_scene", &flat_scene, nb::arg("means"), nb::arg("axes"), nb::arg("opacities"), nb::arg("sh"),
          nb::arg("degree"), nb::arg("background"), nb::arg("levels").none(),
          nb::arg("antialiased"), nb::arg("tolerance"), nb::arg("first_slot"), nb::arg("first_cluster"));
}

}  // namespace splatrl
