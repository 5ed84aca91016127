// Average pooling of images over square cells.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>

#include <algorithm>
#include <array>
#include <stdexcept>
#include <vector>

#include "bindings.h"
#include "interpreter.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

// A cell's rows are summed before its columns, since the rows of an image are contiguous in memory.
void pool_images(uintptr_t images, const std::array<size_t, 4>& shape, size_t side, uintptr_t out) {
    const auto [count, height, width, depth] = shape;
    if (side < 1 || side > 4096) throw std::invalid_argument("side: expected 1 to 4096 pixels");
    const size_t tall = height / side, wide = width / side, run = wide * side * depth, cells = wide * depth;
    const auto* pixels = reinterpret_cast<const uint8_t*>(images);
    auto* written = reinterpret_cast<float*>(out);
    const float area = float(side * side);
    std::vector<int32_t> sums(run);
    const Release release;
    for (size_t image = 0; image < count; ++image)
        for (size_t y = 0; y < tall; ++y, written += cells) {
            std::fill(sums.begin(), sums.end(), 0);
            for (size_t row = 0; row < side; ++row) {
                const uint8_t* line = pixels + (image * height + y * side + row) * width * depth;
                for (size_t i = 0; i < run; ++i) sums[i] += line[i];
            }
            for (size_t x = 0; x < wide; ++x)
                for (size_t c = 0; c < depth; ++c) {
                    int32_t sum = 0;
                    for (size_t i = x * side * depth + c; i < (x + 1) * side * depth; i += depth) sum += sums[i];
                    written[x * depth + c] = float(sum);
                }
            for (size_t i = 0; i < cells; ++i) written[i] = written[i] / area / 255.0f - 0.5f;
        }
}

}  // namespace

void bind_pool(nb::module_& m) {
    m.def("pool_images", &pool_images);
}

}  // namespace splatrl
