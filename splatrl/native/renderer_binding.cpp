#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>

#include "arrays.h"
#include "bindings.h"
#include "interpreter.h"
#include "levels_binding.h"
#include "packed.h"
#include "rigid.h"
#include "renderer.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

using Models = std::optional<Tensor<const int64_t, -1, -1>>;
using Poses = Tensor<const float, -1, -1, 4, 4>;
using Lenses = Tensor<const float, -1, 3, 3>;
// Columns of each frame: projected, visible, blended, project_ms, sort_ms, blend_ms.
using Efforts = std::optional<Tensor<float, -1, 6>>;

void add_model(Renderer& renderer, size_t model, Tensor<const float, -1, 3> means, Tensor<const float, -1, 3, 3> axes,
               Tensor<const float, -1> opacities, Tensor<const float, -1, -1, 3> sh, int degree,
               std::optional<nb::dict> levels) {
    const GaussianArrays gaussians{means.data(), axes.data(), opacities.data(), sh.data(), means.shape(0), degree};
    Levels tree;
    if (levels) tree = levels_of(*levels, gaussians);
    std::optional<Scene> scene;
    {
        const Release release;
        if (!levels) tree = build_levels(gaussians, CLUSTER, GROUP, false);
        scene.emplace(gaussians, tree, renderer.background(), renderer.antialiased());
    }
    renderer.put(model, std::move(scene));  // with the GIL, as other threads may add models
}

void render(Renderer& renderer, const Models& models, const Poses& camera_to_models, const Lenses& K, int width,
            int height, size_t threads, const Images& images, const Efforts& efforts) {
    const Release release;
    const Batch batch{models ? models->data() : nullptr, camera_to_models.data(), K.data(), K.shape(0),
                      camera_to_models.shape(1), width, height};
    std::vector<Effort> taken(efforts ? batch.rows : 0);
    renderer.render(batch, threads, images, efforts ? taken.data() : nullptr);
    float* to = efforts ? efforts->data() : nullptr;
    for (const Effort& effort : taken)
        for (float value : {float(effort.projected), float(effort.visible), float(effort.blended), effort.project_ms,
                            effort.sort_ms, effort.blend_ms})
            *to++ = value;
}

void needs(const Renderer& renderer, Tensor<const float, -1, 6> bounds, Tensor<const float, -1> errors,
           Tensor<const float, -1, 4, 4> camera_to_models, const Lenses& K, int width, int height,
           Tensor<uint8_t, -1, -1> out) {
    std::vector<Bounds> of_models;
    for (size_t model = 0; model < bounds.shape(0); ++model) {
        const float* b = bounds.data() + 6 * model;
        of_models.push_back({{b[0], b[1], b[2]}, b[3], b[4], b[5]});
    }
    const Batch batch{nullptr, camera_to_models.data(), K.data(), K.shape(0), 1, width, height};
    if (errors.shape(0) != of_models.size() || out.shape(0) != batch.rows || out.shape(1) != of_models.size() ||
        camera_to_models.shape(0) != batch.rows)
        throw std::invalid_argument(
            "needs: expected one error per model, one pose per row, and out of shape [rows, models]");
    renderer.needs(of_models.data(), errors.data(), of_models.size(), batch, out.data());
}

// The first row whose pose is not rigid or whose K is not that of a pinhole; -1 if all rows are valid.
int64_t first_bad_camera(const Tensor<const float, -1, 4, 4>& poses, const Lenses& K) {
    for (size_t row = 0; row < poses.shape(0); ++row)
        if (!is_pose_by_fours(poses.data() + 16 * row) || !is_lens(K.data() + 9 * row)) return int64_t(row);
    return -1;
}

// The first part, in row-major order, whose model is neither -1 nor in [0, count) or whose pose is not rigid; -1 if all
// are valid.
int64_t first_bad_part(const Tensor<const int64_t, -1, -1>& models, const Poses& poses, int64_t count) {
    const size_t parts = models.shape(0) * models.shape(1);
    if (poses.shape(0) * poses.shape(1) != parts) throw std::invalid_argument("parts: expected one pose per model");
    for (size_t part = 0; part < parts; ++part) {
        const int64_t model = models.data()[part];
        if (model < -1 || model >= count || (model >= 0 && !is_pose_by_fours(poses.data() + 16 * part)))
            return int64_t(part);
    }
    return -1;
}

// The pose of each row's camera in the frame of each of its parts, computed in double precision and rounded once, like
// camera_to_models in renderers/parts.py.
void camera_to_models(const Tensor<const float, -1, 4, 4>& camera_to_world, const Poses& model_to_world,
                      const Tensor<float, -1, -1, 4, 4>& out) {
    const size_t rows = camera_to_world.shape(0), parts = model_to_world.shape(1);
    if (model_to_world.shape(0) != rows || out.shape(0) != rows || out.shape(1) != parts)
        throw std::invalid_argument(
            "camera_to_models: expected model_to_world and out of equal shape, with one row per camera");
    for (size_t i = 0; i < rows * parts; ++i) {
        const float *camera = camera_to_world.data() + 16 * (i / parts), *model = model_to_world.data() + 16 * i;
        float* pose = out.data() + 16 * i;
        for (int row = 0; row < 3; ++row)
            for (int column = 0; column < 4; ++column) {
                double sum = 0.0;
                for (int axis = 0; axis < 3; ++axis) {
                    const double from = column < 3 ? 0.0 : double(model[4 * axis + 3]);
                    sum += double(model[4 * axis + row]) * (double(camera[4 * axis + column]) - from);
                }
                pose[4 * row + column] = float(sum);
            }
        for (int column = 0; column < 4; ++column) pose[12 + column] = column == 3;
    }
}

}  // namespace

void bind_renderer(nb::module_& m) {
    m.def("camera_to_models", &camera_to_models, nb::arg("camera_to_world"), nb::arg("model_to_world"), nb::arg("out"));
    m.def("first_bad_camera", &first_bad_camera, nb::arg("camera_to_world"), nb::arg("K"));
    m.def("first_bad_part", &first_bad_part, nb::arg("models"), nb::arg("model_to_world"), nb::arg("count"));
    nb::class_<Renderer>(m, "Renderer")
        .def(
            "__init__",
            [](Renderer* self, bool antialiased, std::array<float, 3> background, float tolerance) {
                new (self) Renderer(background, antialiased, tolerance, choose_isa());
            },
            nb::arg("antialiased"), nb::arg("background"), nb::arg("tolerance"))
        .def("add_model", &add_model, nb::arg("model"), nb::arg("means"), nb::arg("axes"), nb::arg("opacities"),
             nb::arg("sh"), nb::arg("degree"), nb::arg("levels").none())
        .def(
            "put_model",
            [](Renderer& self, size_t model, std::optional<nb::dict> arrays) {
                if (arrays)
                    self.put(model, from_arrays(*arrays, self.background()));
                else
                    self.put(model, std::nullopt);
            },
            nb::arg("model"), nb::arg("arrays").none())
        .def("needs", &needs, nb::arg("bounds"), nb::arg("errors"), nb::arg("camera_to_models"), nb::arg("K"),
             nb::arg("width"), nb::arg("height"), nb::arg("out"))
        .def(
            "render",
            [](Renderer& self, Models models, Poses camera_to_models, Lenses K, Tensor<float, -1, -1, -1, 3> rgb,
               Tensor<float, -1, -1, -1> depth, Tensor<float, -1, -1, -1> alpha, size_t threads) {
                render(self, models, camera_to_models, K, int(rgb.shape(2)), int(rgb.shape(1)), threads,
                       {rgb.data(), depth.data(), alpha.data(), nullptr}, std::nullopt);
            },
            nb::arg("models").none(), nb::arg("camera_to_models"), nb::arg("K"), nb::arg("rgb"), nb::arg("depth"),
            nb::arg("alpha"), nb::arg("threads"))
        .def(
            "pixels",
            [](Renderer& self, Models models, Poses camera_to_models, Lenses K,
               Tensor<uint8_t, -1, -1, -1, 3> pixels, Efforts efforts, size_t threads) {
                render(self, models, camera_to_models, K, int(pixels.shape(2)), int(pixels.shape(1)), threads,
                       {nullptr, nullptr, nullptr, pixels.data()}, efforts);
            },
            nb::arg("models").none(), nb::arg("camera_to_models"), nb::arg("K"), nb::arg("pixels"),
            nb::arg("efforts").none(), nb::arg("threads"));
}

}  // namespace splatrl
