// Weather and light on images: the CPU version of envs/transforms/weather_images.py, in one pass over each image.
#include <nanobind/nanobind.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <tuple>

#include "arrays.h"
#include "bindings.h"
#include "buffer.h"
#include "interpreter.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

using Colors = Tensor<const float, -1, 3>;
using Maps = Tensor<const float, -1, -1, -1>;
using Map = Tensor<const float, -1, -1>;
using Numbers = Tensor<const float, -1>;
// Rain and snow. Per layer: cover and rank [K, T, U], and distance [K]. Per image: strength, wind, whether it snows,
// where each of its layers begins on the pattern [B, K / 2, 2], and colour.
using Falling = std::tuple<Maps, Maps, Numbers, Numbers, Numbers, Tensor<const bool, -1>,
                           Tensor<const float, -1, -1, 2>, Colors>;
// Drops on the lens. Of the pattern: shift [T, U, 2], and cover, rank and shine [T, U]. Per image: wetness, and where
// the lens begins on the pattern [B, 2].
using Lens = std::tuple<Tensor<const int64_t, -1, -1, 2>, Map, Map, Map, Numbers, Tensor<const float, -1, 2>>;

struct Image {
    size_t number, height, width;
    const float* far;  // depth of each pixel, metres; null if unknown
};

// Truncate a number to an integer; 0 if it is too large or NaN.
int64_t whole(float value) { return std::fabs(value) < 1e9f ? int64_t(value) : 0; }

// Wrap a number into [0, count).
size_t around(int64_t value, size_t count) {
    const int64_t rest = value % int64_t(count);
    return size_t(rest < 0 ? rest + int64_t(count) : rest);
}

// Write into `clear` the fraction of each pixel that rain or snow leaves uncovered. Returns false if nothing falls.
bool fall(const Falling& falling, const Image& image, float* clear) {
    const auto& [cover, rank, distance, strength, wind, snows, begin, color] = falling;
    const size_t tall = cover.shape(1), wide = cover.shape(2), layers = cover.shape(0) / 2;
    const float strong = strength.data()[image.number], lean = wind.data()[image.number];
    if (!(strong > 0.0f)) return false;
    std::fill(clear, clear + image.height * image.width, 1.0f);
    for (size_t near = 0; near < layers; ++near) {
        const size_t layer = near + (snows.data()[image.number] ? layers : 0);
        const float* place = begin.data() + 2 * (image.number * layers + near);
        const int64_t first_row = whole(place[0] * float(tall)), first_column = whole(place[1] * float(wide));
        const float away = distance.data()[layer];
        for (size_t y = 0; y < image.height; ++y) {
            const size_t line = (layer * tall + around(first_row + int64_t(y), tall)) * wide;
            size_t texel = around(first_column - whole(std::nearbyint(lean * float(y))), wide);
            float* through = clear + y * image.width;
            for (size_t x = 0; x < image.width;) {
                const size_t some = std::min(image.width - x, wide - texel);  // up to where the pattern repeats
                const float *covers = cover.data() + line + texel, *ranks = rank.data() + line + texel;
                const float* far = image.far == nullptr ? nullptr : image.far + y * image.width + x;
                for (size_t i = 0; i < some; ++i) {
                    const bool seen = (ranks[i] < strong) & (far == nullptr || far[i] > away);
                    through[x + i] *= 1.0f - (seen ? covers[i] : 0.0f);
                }
                x += some;
                texel = 0;
            }
        }
    }
    return true;
}

// Draw an image as seen through drops on the lens: `colors` -> `out`.
void through_drops(const Lens& lens, const Image& image, const float* colors, float* out) {
    const auto& [shift, cover, rank, shine, wet, begin] = lens;
    const size_t tall = cover.shape(0), wide = cover.shape(1);
    const float* place = begin.data() + 2 * image.number;
    const int64_t first_row = whole(place[0] * float(tall)), first_column = whole(place[1] * float(wide));
    const int64_t bottom = int64_t(image.height) - 1, right = int64_t(image.width) - 1;
    for (size_t y = 0; y < image.height; ++y) {
        const size_t line = around(first_row + int64_t(y), tall) * wide;
        for (size_t x = 0; x < image.width; ++x, out += 3) {
            const size_t texel = line + around(first_column + int64_t(x), wide);
            const float* own = colors + 3 * (y * image.width + x);
            const float covered = rank.data()[texel] < wet.data()[image.number] ? cover.data()[texel] : 0.0f;
            std::copy_n(own, 3, out);
            if (covered == 0.0f) continue;
            const int64_t row = std::clamp(int64_t(y) + shift.data()[2 * texel], int64_t(0), bottom);
            const int64_t column = std::clamp(int64_t(x) + shift.data()[2 * texel + 1], int64_t(0), right);
            const float* bent = colors + 3 * (size_t(row) * image.width + size_t(column));
            const float light = shine.data()[texel] * (0.25f + (bent[0] + bent[1] + bent[2]) / 3.0f);
            for (int i = 0; i < 3; ++i) out[i] = own[i] + covered * (bent[i] + light - own[i]);
        }
    }
}

void put_into_weather(const Tensor<const uint8_t, -1, -1, -1, 3>& pixels, const Colors& tint, const Colors& veil,
                      const std::optional<Maps>& left, const std::optional<Maps>& far,
                      const std::optional<Falling>& falling, const std::optional<Lens>& lens,
                      const Tensor<uint8_t, -1, -1, -1, 3>& out, size_t threads) {
    const size_t count = pixels.shape(0), height = pixels.shape(1), width = pixels.shape(2), area = height * width;
    const auto fits = [&](const auto& one) { return one.shape(0) == count; };
    const auto covers = [&](const auto& one) { return fits(one) && one.shape(1) == height && one.shape(2) == width; };
    bool right = fits(tint) && fits(veil) && covers(out) && (!left || covers(*left)) && (!far || covers(*far));
    if (falling) {
        const auto& [cover, rank, distance, strength, wind, snows, begin, color] = *falling;
        right = right && fits(strength) && fits(wind) && fits(snows) && fits(begin) && fits(color);
        right = right && cover.size() > 0 && rank.size() == cover.size() && distance.size() == cover.shape(0);
        right = right && 2 * begin.shape(1) == cover.shape(0);
    }
    if (lens) {
        const auto& [shift, cover, rank, shine, wet, begin] = *lens;
        right = right && fits(wet) && fits(begin) && cover.size() > 0 && rank.size() == cover.size();
        right = right && shine.size() == cover.size() && shift.size() == 2 * cover.size();
    }
    if (!right)
        throw std::invalid_argument("weather: expected one row per image, and matching sizes of images and textures");
    const Release release;
    parallel_for(count, threads, [&](size_t, size_t number) {
        const Image image{number, height, width, far ? far->data() + number * area : nullptr};
        const Buffer<float> memory = make_buffer<float>(7 * area);
        float *colors = memory.get(), *clear = colors + 3 * area, *bent = clear + area;
        const uint8_t* given = pixels.data() + 3 * number * area;
        const float *tints = tint.data() + 3 * number, *veils = veil.data() + 3 * number;
        for (size_t i = 0; i < area; ++i)
            for (size_t c = 0; c < 3; ++c) colors[3 * i + c] = float(given[3 * i + c]) / 255.0f * tints[c];
        if (left) {
            const float* light = left->data() + number * area;
            for (size_t i = 0; i < area; ++i)
                for (size_t c = 0; c < 3; ++c)
                    colors[3 * i + c] = colors[3 * i + c] * light[i] + (1.0f - light[i]) * veils[c];
        }
        if (falling && fall(*falling, image, clear)) {
            const float* color = std::get<7>(*falling).data() + 3 * number;
            for (size_t i = 0; i < area; ++i)
                for (size_t c = 0; c < 3; ++c)
                    colors[3 * i + c] = colors[3 * i + c] + (1.0f - clear[i]) * (color[c] - colors[3 * i + c]);
        }
        if (lens && std::get<4>(*lens).data()[number] > 0.0f) {
            through_drops(*lens, image, colors, bent);
            colors = bent;
        }
        uint8_t* written = out.data() + 3 * number * area;
        for (size_t i = 0; i < 3 * area; ++i)
            written[i] = uint8_t(std::min(std::max(0.0f, 255.0f * colors[i] + 0.5f), 255.0f));  // NaN becomes 0
    });
}

}  // namespace

void bind_weather(nb::module_& m) {
    m.def("put_into_weather", &put_into_weather, nb::arg("pixels"), nb::arg("tint"), nb::arg("veil"),
          nb::arg("left").none(), nb::arg("far").none(), nb::arg("falling").none(), nb::arg("lens").none(),
          nb::arg("out"), nb::arg("threads"));
}

}  // namespace splatrl
