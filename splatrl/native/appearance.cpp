// Random changes of how images look (blur, colour, sensor noise): the CPU version of envs/transforms/appearance.py, in
// one pass over each image, with the same operations in the same order as its PyTorch code.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>

#include <algorithm>
#include <optional>
#include <stdexcept>

#include "arrays.h"
#include "bindings.h"
#include "buffer.h"
#include "interpreter.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

using Rows = Tensor<const float, -1, -1>;
using Numbers = Tensor<const float, -1>;

// Blur along one axis: weights[0] · line plus, for each step, weights[step + 1] · (before[step] + after[step]).
void blur_line(const float* line, const float* const* before, const float* const* after, const float* weights,
               size_t steps, size_t size, float* out) {
    for (size_t i = 0; i < size; ++i) out[i] = line[i] * weights[0];
    for (size_t step = 0; step < steps; ++step) {
        const float *a = before[step], *b = after[step], weight = weights[step + 1];
        for (size_t i = 0; i < size; ++i) out[i] += (a[i] + b[i]) * weight;
    }
}

// The radius of a blur in steps: all weights beyond it are 0.
size_t steps_of(const float* weights, size_t steps) {
    while (steps > 0 && weights[steps] == 0.0f) --steps;
    return steps;
}

void change_appearance(const Tensor<const uint8_t, -1, -1, -1, 3>& pixels, const Rows& weights, const Rows& gain,
                       const Rows& offset, const Numbers& grain,
                       const std::optional<Tensor<const float, -1, -1, -1>>& noise,
                       const Tensor<uint8_t, -1, -1, -1, 3>& out, size_t threads) {
    const size_t count = pixels.shape(0), height = pixels.shape(1), width = pixels.shape(2), line = 3 * width;
    const auto fits = [&](const auto& one) { return one.shape(0) == count; };
    const bool right = fits(weights) && fits(gain) && fits(offset) && fits(grain) && fits(out) &&
                       weights.shape(1) > 0 && gain.shape(1) == 3 && offset.shape(1) == 3 && out.shape(1) == height &&
                       out.shape(2) == width &&
                       (!noise || (fits(*noise) && noise->shape(1) == height && noise->shape(2) == line));
    if (!right)
        throw std::invalid_argument(
            "appearance: expected every argument to have one row per image, and matching image sizes");
    if (pixels.size() == 0) return;
    const Release release;
    const size_t reach = weights.shape(1) - 1;
    parallel_for(count, threads, [&](size_t, size_t number) {
        const float* weight = weights.data() + number * (reach + 1);
        const size_t steps = steps_of(weight, reach), margin = 3 * steps;
        const Buffer<float> memory = make_buffer<float>(height * line + 4 * line + 2 * margin);
        float *colors = memory.get(), *scale = colors + height * line, *shift = scale + line, *blurred = shift + line;
        float* padded = blurred + line;  // a line whose first and last pixels are repeated beyond its ends
        const Buffer<const float*> lines = make_buffer<const float*>(2 * steps);
        const float **before = lines.get(), **after = before + steps;
        const uint8_t* given = pixels.data() + number * height * line;
        std::copy_n(given, height * line, colors);
        for (size_t i = 0; i < line; ++i) {
            scale[i] = gain.data()[3 * number + i % 3];
            shift[i] = offset.data()[3 * number + i % 3];
        }
        for (size_t y = 0; y < height; ++y) {
            const float* row = colors + y * line;
            if (steps > 0) {
                for (size_t step = 1; step <= steps; ++step) {
                    before[step - 1] = colors + (y - std::min(y, step)) * line;
                    after[step - 1] = colors + std::min(y + step, height - 1) * line;
                }
                float* middle = padded + margin;
                blur_line(row, before, after, weight, steps, line, middle);
                for (size_t i = 0; i < margin; ++i) {
                    padded[i] = middle[i % 3];
                    middle[line + i] = middle[line - 3 + i % 3];
                }
                for (size_t step = 1; step <= steps; ++step) {
                    before[step - 1] = middle - 3 * step;
                    after[step - 1] = middle + 3 * step;
                }
                blur_line(middle, before, after, weight, steps, line, blurred);
                row = blurred;
            }
            float* changed = padded;  // reused: the padded line is no longer needed
            for (size_t i = 0; i < line; ++i) changed[i] = row[i] * scale[i] + shift[i];
            if (noise) {
                const float *added = noise->data() + (number * height + y) * line, most = grain.data()[number];
                for (size_t i = 0; i < line; ++i) changed[i] += added[i] * most;
            }
            uint8_t* written = out.data() + (number * height + y) * line;
            for (size_t i = 0; i < line; ++i)  // NaN becomes 0
                written[i] = uint8_t(std::min(std::max(0.0f, changed[i] + 0.5f), 255.0f));
        }
    });
}

}  // namespace

void bind_appearance(nb::module_& m) {
    m.def("change_appearance", &change_appearance, nb::arg("pixels"), nb::arg("weights"), nb::arg("gain"),
          nb::arg("offset"), nb::arg("grain"), nb::arg("noise").none(), nb::arg("out"), nb::arg("threads"));
}

}  // namespace splatrl
