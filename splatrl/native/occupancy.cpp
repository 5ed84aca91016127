// Absorption of light by the voxels of a grid, summed over Gaussians.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include <nanobind/nanobind.h>

#include "arrays.h"
#include "bindings.h"
#include "interpreter.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

// A Gaussian, prepared for its distances from voxels. Let u_j be its axes and s_j its standard deviations, all in
// voxels. The box along its axes that encloses the unit voxel at v extends half_j = |u_j|_1 / 2s_j standard deviations
// to either side of its centre, so the squared distance from the mean to that box, in standard deviations, is the sum
// over j of max(|u_j . (v + 1/2 - mean)| / s_j - half_j, 0)^2.
struct Ellipsoid {
    std::array<double, 3> mean;
    std::array<std::array<double, 3>, 3> whitening;  // row j is u_j / s_j
    std::array<double, 3> half;

    Ellipsoid(const double* mean_in, const double* axes, const double* scales) {
        for (size_t i = 0; i < 3; ++i) mean[i] = mean_in[i];
        for (size_t j = 0; j < 3; ++j) {
            half[j] = 0.0;
            for (size_t i = 0; i < 3; ++i) {
                whitening[j][i] = axes[3 * i + j] / scales[j];
                half[j] += 0.5 * std::abs(whitening[j][i]);
            }
        }
    }
};

using Triple = std::array<int64_t, 3>;

// Add the Gaussian to the voxels in [first, end) that lie within `extent` standard deviations, by columns along z.
void splat(const Ellipsoid& g, double opacity, double extent, const Triple& first, const Triple& end,
           const Triple& shape, float* density) {
    for (int64_t x = first[0]; x < end[0]; ++x) {
        poll();
        for (int64_t y = first[1]; y < end[1]; ++y) {
            const double dx = double(x) + 0.5 - g.mean[0], dy = double(y) + 0.5 - g.mean[1];
            std::array<double, 3> at_zero;  // whitened offset of the column from the mean, at the mean's height
            double low = double(first[2]), high = double(end[2] - 1);  // range of heights that no axis rules out
            for (size_t j = 0; j < 3; ++j) {
                at_zero[j] = g.whitening[j][0] * dx + g.whitening[j][1] * dy;
                const double slope = g.whitening[j][2], reach = extent + g.half[j];
                if (slope == 0.0) {
                    if (std::abs(at_zero[j]) > reach) high = low - 1.0;
                    continue;
                }
                const double middle = g.mean[2] - 0.5 - at_zero[j] / slope, width = reach / std::abs(slope);
                low = std::max(low, std::floor(middle - width));
                high = std::min(high, std::ceil(middle + width));
            }
            if (!(low <= high)) continue;
            float* column = density + (x * shape[1] + y) * shape[2];
            for (int64_t z = int64_t(low); z <= int64_t(high); ++z) {
                const double dz = double(z) + 0.5 - g.mean[2];
                double square = 0.0;
                for (size_t j = 0; j < 3; ++j) {
                    const double gap = std::max(std::abs(at_zero[j] + g.whitening[j][2] * dz) - g.half[j], 0.0);
                    square += gap * gap;
                }
                if (square <= extent * extent) column[z] += float(opacity * std::exp(-0.5 * square));
            }
        }
    }
}

void add_density(Tensor<const double, -1, 3> means, Tensor<const double, -1, 3, 3> axes,
                 Tensor<const double, -1, 3> scales, Tensor<const double, -1> opacities,
                 Tensor<const int64_t, -1, 3> first, Tensor<const int64_t, -1, 3> end, double extent,
                 Tensor<float, -1, -1, -1> density) {
    const size_t count = means.shape(0);
    const Triple shape{int64_t(density.shape(0)), int64_t(density.shape(1)), int64_t(density.shape(2))};
    if (axes.shape(0) != count || scales.shape(0) != count || opacities.shape(0) != count ||
        first.shape(0) != count || end.shape(0) != count)
        throw nb::value_error("add_density: expected as many axes, scales, opacities and voxel ranges as means");
    const Release release;
    for (size_t n = 0; n < count; ++n) {
        Triple low, high;
        for (size_t i = 0; i < 3; ++i) {
            low[i] = std::max<int64_t>(first.data()[3 * n + i], 0);
            high[i] = std::min(end.data()[3 * n + i], shape[i]);
        }
        const Ellipsoid gaussian(means.data() + 3 * n, axes.data() + 9 * n, scales.data() + 3 * n);
        splat(gaussian, opacities.data()[n], extent, low, high, shape, density.data());
    }
}

}  // namespace

void bind_occupancy(nb::module_& m) {
    m.def("add_density", &add_density, nb::arg("means"), nb::arg("axes"), nb::arg("scales"), nb::arg("opacities"),
          nb::arg("first"), nb::arg("end"), nb::arg("extent"), nb::arg("density"));
}

}  // namespace splatrl
