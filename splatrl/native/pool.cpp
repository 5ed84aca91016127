// Average pooling of images over square cells.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>

#include <algorithm>
#include <array>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "bindings.h"
#include "interpreter.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

using Shape = std::array<size_t, 4>;  // images, height, width, channels

// Average images over square cells, in units of `most`, and subtract a half. A cell's rows are summed before its
// columns, since the rows of an image are contiguous in memory.
template <class Sum, class Value>
void average_cells(const Value* pixels, const Shape& shape, size_t side, float most, float* out) {
    const auto [count, height, width, depth] = shape;
    const size_t tall = height / side, wide = width / side, run = wide * side * depth, cells = wide * depth;
    const float area = float(side * side);
    std::vector<Sum> sums(run);
    for (size_t image = 0; image < count; ++image)
        for (size_t y = 0; y < tall; ++y, out += cells) {
            std::fill(sums.begin(), sums.end(), Sum(0));
            for (size_t row = 0; row < side; ++row) {
                const Value* line = pixels + (image * height + y * side + row) * width * depth;
                for (size_t i = 0; i < run; ++i) sums[i] += line[i];
            }
            for (size_t x = 0; x < wide; ++x)
                for (size_t c = 0; c < depth; ++c) {
                    Sum sum = 0;
                    for (size_t i = x * side * depth + c; i < (x + 1) * side * depth; i += depth) sum += sums[i];
                    out[x * depth + c] = float(sum);
                }
            for (size_t i = 0; i < cells; ++i) out[i] = out[i] / area / most - 0.5f;
        }
}

void pool_images(Address images, const Shape& shape, size_t side, bool floats, Address out) {
    if (side < 1 || side > 4096) throw std::invalid_argument("side: expected 1 to 4096 pixels");
    const Release release;
    if (floats)
        average_cells<float>(at(images), shape, side, 1.0f, at(out));
    else
        average_cells<int32_t>(at<const uint8_t>(images), shape, side, 255.0f, at(out));
}

}  // namespace

void bind_pool(nb::module_& m) {
    m.def("pool_images", &pool_images);
}

}  // namespace splatrl
