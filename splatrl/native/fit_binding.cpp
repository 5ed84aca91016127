#include <nanobind/nanobind.h>

#include <cmath>
#include <stdexcept>

#include "arrays.h"
#include "bindings.h"
#include "fitter.h"
#include "interpreter.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

using Values = Tensor<float, -1, -1>;
using Poses = Tensor<const float, -1, 4, 4>;
using Lenses = Tensor<const float, -1, 3, 3>;
using Slopes = Tensor<float, -1, -1, -1>;

using Known = Tensor<const float, -1, -1, -1>;

void require(bool fits, const char* expected) {
    if (!fits) throw std::invalid_argument(expected);
}

FitBatch batch_of(const Values& values, size_t count, float near, const Poses& poses, const Lenses& K, size_t width,
                  size_t height, const std::vector<const float*>& known) {
    require(K.shape(0) == poses.shape(0), "K: expected intrinsics for each camera");
    require(known.size() == poses.shape(0), "known: expected depths for each camera");
    int degree = 0;
    while (degree < 3 && size_t(FIT_SH + 3 * (degree + 1) * (degree + 1)) < values.shape(0)) ++degree;
    if (size_t(FIT_SH + 3 * (degree + 1) * (degree + 1)) != values.shape(0))
        throw std::invalid_argument("values: expected 14, 23, 38 or 59 rows");
    if (values.shape(1) % FIT_LANES != 0 || count > values.shape(1) || uintptr_t(values.data()) % 64 != 0)
        throw std::invalid_argument(
            "values: expected rows aligned to 64 bytes whose length is a multiple of 16 and at least count");
    if (width > 8192 || height > 8192) throw std::invalid_argument("images: expected at most 8192 pixels per side");
    const FitModel model{values.data(), values.shape(1), uint32_t(count), degree, near};
    return {model, poses.data(), K.data(), known.data(), poses.shape(0), int(width), int(height)};
}

std::vector<const float*> planes_of(const Known& known, size_t width, size_t height) {
    require(known.shape(1) == height && known.shape(2) == width, "known: expected depths as large as the images");
    std::vector<const float*> planes;
    for (size_t view = 0; view < known.shape(0); ++view)
        planes.push_back(known.data() + view * known.shape(1) * known.shape(2));
    return planes;
}

void require_gradients(const Slopes& gradients, const Values& values, size_t views) {
    require(gradients.shape(0) >= views && gradients.shape(1) == values.shape(0) &&
                gradients.shape(2) == values.shape(1),
            "gradients: expected the shape of values for each camera");
}

void render(Fitter& fitter, Values values, size_t count, float near, Poses poses, Lenses K,
            Known known, Tensor<float, -1, -1, -1, 3> rgb, Slopes agreement, Slopes alpha, size_t threads) {
    const size_t views = rgb.shape(0), height = rgb.shape(1), width = rgb.shape(2);
    const std::vector<const float*> planes = planes_of(known, width, height);
    const FitBatch batch = batch_of(values, count, near, poses, K, width, height, planes);
    require(views == batch.views, "rgb: expected an image for each camera");
    for (const Slopes* plane : {&agreement, &alpha})
        require(plane->shape(0) == views && plane->shape(1) == height && plane->shape(2) == width,
                "agreement, alpha: expected the shape of rgb");
    const Release release;
    fitter.render(batch, threads, rgb.data(), agreement.data(), alpha.data());
}

void pull(Fitter& fitter, Values values, size_t count, float near, Poses poses, Lenses K,
          Known known, Tensor<const float, -1, -1, -1, 5> slopes, Slopes gradients,
          Tensor<float, -1, 6> turns, size_t threads) {
    const std::vector<const float*> planes = planes_of(known, slopes.shape(2), slopes.shape(1));
    const FitBatch batch = batch_of(values, count, near, poses, K, slopes.shape(2), slopes.shape(1), planes);
    require(slopes.shape(0) == batch.views, "slopes: expected an image for each camera");
    require(turns.shape(0) == batch.views, "pose_slopes: expected a row for each camera");
    require_gradients(gradients, values, batch.views);
    const Release release;
    fitter.pull(batch, threads, slopes.data(), gradients.data(), turns.data());
}

void compare(Fitter& fitter, Values values, size_t count, float near, Poses poses, Lenses K,
             Tensor<const uint8_t, -1, -1, -1, 3> pixels, Known known, Tensor<const int64_t, -1> chosen,
             Tensor<const float, -1, 3, 2> exposure, float ssim_weight, float depth_weight, Slopes gradients,
             Tensor<float, -1, 16> losses, size_t threads) {
    const std::vector<const float*> all = planes_of(known, pixels.shape(2), pixels.shape(1));
    require(all.size() == pixels.shape(0), "known: expected depths for each photo");
    require(exposure.shape(0) == pixels.shape(0), "exposure: expected a row for each photo");
    std::vector<const float*> planes;
    for (size_t view = 0; view < chosen.shape(0); ++view) {
        require(size_t(chosen.data()[view]) < all.size(), "chosen: expected indices of photos");
        planes.push_back(all[size_t(chosen.data()[view])]);
    }
    const FitBatch batch = batch_of(values, count, near, poses, K, pixels.shape(2), pixels.shape(1), planes);
    require(losses.shape(0) == batch.views, "losses: expected a row for each camera");
    require_gradients(gradients, values, batch.views);
    const Release release;
    std::vector<FitTarget> targets;
    std::vector<FitLoss> found(batch.views);
    const size_t image = pixels.shape(1) * pixels.shape(2) * 3;
    for (size_t view = 0; view < batch.views; ++view) {
        const size_t photo = size_t(chosen.data()[view]);
        targets.push_back({pixels.data() + photo * image, exposure.data() + 6 * photo, ssim_weight, depth_weight});
    }
    fitter.compare(batch, threads, targets.data(), gradients.data(), found.data());
    float* to = losses.data();
    for (const FitLoss& loss : found) {
        *to++ = loss.total, *to++ = loss.l1, *to++ = loss.ssim, *to++ = loss.depth;
        for (float slope : loss.exposure) *to++ = slope;
        for (float slope : loss.pose) *to++ = slope;
    }
}

void update(Fitter& fitter, Values values, Slopes gradients, Values first, Values second,
            Tensor<const float, -1> rates, int step, float beta1, float beta2, float epsilon, float opacity_slope,
            float scale_slope, float noise, uint64_t seed, size_t threads) {
    require_gradients(gradients, values, 1);
    for (const Values* moment : {&first, &second})
        require(moment->shape(0) == values.shape(0) && moment->shape(1) == values.shape(1),
                "first, second: expected the shape of values");
    require(rates.shape(0) == values.shape(0), "rates: expected one rate per row of values");
    const Release release;
    const float correction1 = float(1.0 / (1.0 - std::pow(double(beta1), step)));
    const float correction2 = float(1.0 / (1.0 - std::pow(double(beta2), step)));
    fitter.update({values.data(), gradients.data(), gradients.shape(0), first.data(), second.data(), rates.data(),
                   values.shape(0), values.shape(1), beta1, beta2, epsilon, correction1, correction2, opacity_slope,
                   scale_slope, noise, seed},
                  threads);
}

}  // namespace

void bind_fit(nb::module_& m) {
    using nb::arg;
    nb::class_<Fitter>(m, "Fitter")
        .def("__init__", [](Fitter* self) { new (self) Fitter(choose_isa()); })
        .def("render", &render, arg("values"), arg("count"), arg("near"), arg("camera_to_world"), arg("K"),
             arg("known"), arg("rgb"), arg("agreement"), arg("alpha"), arg("threads"))
        .def("pull", &pull, arg("values"), arg("count"), arg("near"), arg("camera_to_world"), arg("K"), arg("known"),
             arg("slopes"), arg("gradients"), arg("pose_slopes"), arg("threads"))
        .def("compare", &compare, arg("values"), arg("count"), arg("near"), arg("camera_to_world"), arg("K"),
             arg("pixels"), arg("known"), arg("chosen"), arg("exposure"), arg("ssim_weight"), arg("depth_weight"),
             arg("gradients"), arg("losses"), arg("threads"))
        .def("update", &update, arg("values"), arg("gradients"), arg("first"), arg("second"), arg("rates"),
             arg("step"), arg("beta1"), arg("beta2"), arg("epsilon"), arg("opacity_slope"), arg("scale_slope"),
             arg("noise"), arg("seed"), arg("threads"));
}

}  // namespace splatrl
