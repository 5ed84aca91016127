#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>

#include "arrays.h"
#include "bindings.h"
#include "levels_binding.h"
#include "renderer.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

using Poses = Tensor<const float, -1, 4, 4>;
using Lenses = Tensor<const float, -1, 3, 3>;
// Of each frame: projected, visible, blended, project_ms, sort_ms, blend_ms.
using Efforts = Tensor<float, -1, 6>;

void render(Renderer& renderer, const Poses& camera_to_world, const Lenses& K, int width, int height, size_t threads,
            const Images& images, const Efforts& efforts) {
    const nb::gil_scoped_release release;
    std::vector<Effort> taken(camera_to_world.shape(0));
    renderer.render(camera_to_world.data(), K.data(), taken.size(), width, height, threads, images, taken.data());
    float* to = efforts.data();
    for (const Effort& effort : taken)
        for (float value : {float(effort.projected), float(effort.visible), float(effort.blended), effort.project_ms,
                            effort.sort_ms, effort.blend_ms})
            *to++ = value;
}

}  // namespace

void bind_renderer(nb::module_& m) {
    nb::class_<Renderer>(m, "Renderer")
        .def(
            "__init__",
            [](Renderer* self, Tensor<const float, -1, 3> means, Tensor<const float, -1, 3, 3> axes,
               Tensor<const float, -1> opacities, Tensor<const float, -1, -1, 3> sh, int degree, bool antialiased,
               std::array<float, 3> background, std::optional<nb::dict> levels, float tolerance) {
                const GaussianArrays gaussians{means.data(), axes.data(),    opacities.data(),
                                               sh.data(),    means.shape(0), degree};
                const Levels tree = levels ? levels_of(*levels, gaussians)
                                           : build_levels(gaussians, CLUSTER, GROUP, false);
                new (self) Renderer(Scene(gaussians, tree, background, antialiased), antialiased, tolerance, choose_isa());
            },
            nb::arg("means"), nb::arg("axes"), nb::arg("opacities"), nb::arg("sh"), nb::arg("degree"),
            nb::arg("antialiased"), nb::arg("background"), nb::arg("levels").none(), nb::arg("tolerance"))
        .def(
            "render",
            [](Renderer& self, Poses camera_to_world, Lenses K, Tensor<float, -1, -1, -1, 3> rgb,
               Tensor<float, -1, -1, -1> depth, Tensor<float, -1, -1, -1> alpha, Efforts efforts, size_t threads) {
                render(self, camera_to_world, K, int(rgb.shape(2)), int(rgb.shape(1)), threads,
                       {rgb.data(), depth.data(), alpha.data(), nullptr}, efforts);
            },
            nb::arg("camera_to_world"), nb::arg("K"), nb::arg("rgb"), nb::arg("depth"), nb::arg("alpha"),
            nb::arg("efforts"), nb::arg("threads"))
        .def(
            "pixels",
            [](Renderer& self, Poses camera_to_world, Lenses K, Tensor<uint8_t, -1, -1, -1, 3> pixels, Efforts efforts,
               size_t threads) {
                render(self, camera_to_world, K, int(pixels.shape(2)), int(pixels.shape(1)), threads,
                       {nullptr, nullptr, nullptr, pixels.data()}, efforts);
            },
            nb::arg("camera_to_world"), nb::arg("K"), nb::arg("pixels"), nb::arg("efforts"), nb::arg("threads"));
}

}  // namespace splatrl
