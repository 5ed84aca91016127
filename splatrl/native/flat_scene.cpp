// A scene in the layout that CUDA reads: what culling needs is stored by slot, in the order of the tree; what blending
// needs is stored by index, since the sorted keys hold indices.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "arrays.h"
#include "bindings.h"
#include "flat_scene.h"
#include "half.h"
#include "packed.h"
#include "scene.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

// Round a value up to a half float, which is infinite beyond LARGEST_HALF, and return its bits.
uint16_t half_above(float value) {
    const uint16_t half = to_half(value);
    return from_half(half) < value ? half + 1 : half;
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

// The number of indices that a scene's Gaussians need: one more than the largest.
size_t indices_of(const SceneView& view, size_t capacity) {
    return capacity == 0 ? 0 : 1 + size_t(*std::max_element(view.original_index, view.original_index + capacity));
}

nb::dict flat_scene(const nb::dict& packed, std::array<float, 3> background, bool antialiased, float tolerance) {
    const Scene scene = from_arrays(packed, background);
    const SceneView view = scene.view(0.0f);
    const size_t capacity = scene.capacity(), all = indices_of(view, capacity);
    FlatScene flat(view, capacity, all, antialiased);
    nb::dict out;
    out["spheres"] = to_numpy(std::move(flat.spheres), {capacity, size_t(SPHERE)});
    out["shapes"] = to_numpy(std::move(flat.shapes), {all, size_t(SHAPE)});
    out["colors"] = to_numpy(std::move(flat.colors), {all, size_t(color_stride(view.degree))});
    out["indices"] = to_numpy(std::move(flat.indices), {capacity});
    out["tolerance"] = held_tolerance(tolerance, antialiased);
    out["clusters"] = bytes_of(view.clusters, view.cluster_count);
    out["group_bounds"] = bytes_of(view.group_bounds, view.cluster_count);
    return out;
}

}  // namespace

void bind_flat_scene(nb::module_& m) {
    m.def("flat_scene", &flat_scene, nb::arg("packed"), nb::arg("background"), nb::arg("antialiased"),
          nb::arg("tolerance"));
}

}  // namespace splatrl
