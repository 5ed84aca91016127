// Kernels of the convolutional network, compiled once for each instruction set. All sums are kept in registers, as many
// as there are, so that a weight that is read once serves several pixels or images.
#include "trunk.h"

#include <algorithm>
#include <cstring>

#include "kernels/products.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Call work(Width<N>(), first) for N registers of the channels at a time: the largest N up to 3 that divides them.
template <class Work>
LANE_INLINE void in_widths(int channels, const Work& work) {
    const int registers = channels / WIDTH;
    if (registers % 3 == 0)
        for (int v = 0; v < registers; v += 3) work(Width<3>(), v * WIDTH);
    else if (registers % 2 == 0)
        for (int v = 0; v < registers; v += 2) work(Width<2>(), v * WIDTH);
    else
        for (int v = 0; v < registers; ++v) work(Width<1>(), v * WIDTH);
}

// Computes some pixels of a row of the output.
template <int WIDE>
struct ForwardRow {
    const Convolution& shape;
    const float *image, *weights, *bias;  // from the row's first window; from the first output channel
    float* out;

    template <int PIXELS>
    __attribute__((noinline)) void run(int begin) const {
        const size_t step = size_t(shape.stride) * size_t(shape.in), line = size_t(shape.width) * size_t(shape.in);
        const size_t outs = size_t(shape.out);
        const int run = shape.run();
        Register sums[PIXELS][WIDE];
        UNROLL for (int p = 0; p < PIXELS; ++p)
            UNROLL for (int v = 0; v < WIDE; ++v) sums[p][v] = get(bias + v * WIDTH);
        const float* weight = weights;
        for (int y = 0; y < shape.side; ++y) {
            const float* from = image + size_t(y) * line + size_t(begin) * step;
            for (int k = 0; k < run; ++k, weight += outs) {
                Register w[WIDE];
                UNROLL for (int v = 0; v < WIDE; ++v) w[v] = get(weight + v * WIDTH);
                UNROLL for (int p = 0; p < PIXELS; ++p)
                    UNROLL for (int v = 0; v < WIDE; ++v)
                        sums[p][v] = sums[p][v] + w[v] * from[size_t(p) * step + size_t(k)];
            }
        }
        UNROLL for (int p = 0; p < PIXELS; ++p)
            UNROLL for (int v = 0; v < WIDE; ++v) put(out + size_t(begin + p) * outs + v * WIDTH, positive(sums[p][v]));
    }
};

static void convolve(const Convolution& shape, const float* image, const float* weights, const float* bias,
                     float* out) {
    const size_t line = size_t(shape.width) * size_t(shape.in), wide = size_t(shape.wide());
    for (int y = 0; y < shape.tall(); ++y)
        in_widths(shape.out, [&](auto width, int first) {
            constexpr int WIDE = decltype(width)::value;
            const ForwardRow<WIDE> row{shape, image + size_t(y * shape.stride) * line, weights + first, bias + first,
                                       out + size_t(y) * wide * size_t(shape.out) + first};
            in_parts<(SUMS / WIDE > 16 ? 16 : SUMS / WIDE)>(int(wide), row);
        });
}

// Computes the gradient of some weights of one row of the window: a sum over the pixels of the output.
template <int WIDE>
struct WeightGradient {
    const Convolution& shape;
    const float *image, *slope;  // from the row of the window; from the first output channel
    float* out;                  // [run, out]

    template <int COUNT>
    __attribute__((noinline)) void run(int begin) const {
        const size_t step = size_t(shape.stride) * size_t(shape.in), line = size_t(shape.width) * size_t(shape.in);
        const size_t outs = size_t(shape.out), wide = size_t(shape.wide());
        Register sums[COUNT][WIDE];
        float* to = out + size_t(begin) * outs;
        UNROLL for (int k = 0; k < COUNT; ++k)
            UNROLL for (int v = 0; v < WIDE; ++v) sums[k][v] = get(to + size_t(k) * outs + v * WIDTH);
        const float* d = slope;
        for (int y = 0; y < shape.tall(); ++y) {
            const float* from = image + size_t(y * shape.stride) * line + begin;
            for (size_t x = 0; x < wide; ++x, from += step, d += outs) {
                Register by[WIDE];
                UNROLL for (int v = 0; v < WIDE; ++v) by[v] = get(d + v * WIDTH);
                UNROLL for (int k = 0; k < COUNT; ++k)
                    UNROLL for (int v = 0; v < WIDE; ++v) sums[k][v] = sums[k][v] + by[v] * from[k];
            }
        }
        UNROLL for (int k = 0; k < COUNT; ++k)
            UNROLL for (int v = 0; v < WIDE; ++v) put(to + size_t(k) * outs + v * WIDTH, sums[k][v]);
    }
};

static void add_gradients(const Convolution& shape, const float* image, const float* slope, float* weights,
                          float* bias) {
    const size_t line = size_t(shape.width) * size_t(shape.in), outs = size_t(shape.out);
    for (int y = 0; y < shape.side; ++y)
        in_widths(shape.out, [&](auto width, int first) {
            constexpr int WIDE = decltype(width)::value;
            const WeightGradient<WIDE> row{shape, image + size_t(y) * line, slope + first,
                                           weights + size_t(y) * size_t(shape.run()) * outs + first};
            in_parts<(SUMS / WIDE > 16 ? 16 : SUMS / WIDE)>(shape.run(), row);
        });
    const size_t pixels = shape.written() / outs;
    for (size_t first = 0; first < outs; first += WIDTH) {
        Register sum = get(bias + first);
        for (size_t p = 0; p < pixels; ++p) sum = sum + get(slope + p * outs + first);
        put(bias + first, sum);
    }
}

// Adds what some pixels of a row of the output contribute to the gradient of a row of the image, through one row of
// their windows.
template <int WIDE>
struct BackwardRow {
    const Convolution& shape;
    const float *slope, *weights;  // from the row's first pixel; [out, run] from the run's first number
    float* out;                    // from the first number of the first window's run

    template <int PIXELS>
    __attribute__((noinline)) void run(int begin) const {
        const size_t step = size_t(shape.stride) * size_t(shape.in), outs = size_t(shape.out),
            run = size_t(shape.run());
        const float* from = slope + size_t(begin) * outs;
        Register sums[PIXELS][WIDE];
        UNROLL for (int p = 0; p < PIXELS; ++p)
            UNROLL for (int v = 0; v < WIDE; ++v) sums[p][v] = Register{};
        const float* weight = weights;
        for (size_t o = 0; o < outs; ++o, weight += run) {
            Register w[WIDE];
            UNROLL for (int v = 0; v < WIDE; ++v) w[v] = get(weight + v * WIDTH);
            UNROLL for (int p = 0; p < PIXELS; ++p)
                UNROLL for (int v = 0; v < WIDE; ++v) sums[p][v] = sums[p][v] + w[v] * from[size_t(p) * outs + o];
        }
        float* to = out + size_t(begin) * step;
        UNROLL for (int p = 0; p < PIXELS; ++p)
            UNROLL for (int v = 0; v < WIDE; ++v) {
                float* place = to + size_t(p) * step + v * WIDTH;
                put(place, get(place) + sums[p][v]);
            }
    }
};

// Gradient of a convolution's input, from that of its output.
static void convolve_back(const Convolution& shape, const float* slope, const float* weights, float* out) {
    const size_t line = size_t(shape.width) * size_t(shape.in), wide = size_t(shape.wide());
    const size_t outs = size_t(shape.out), run = size_t(shape.run());
    std::memset(out, 0, sizeof(float) * shape.read());
    for (int y = 0; y < shape.tall(); ++y)
        for (int row = 0; row < shape.side; ++row)
            in_widths(shape.run(), [&](auto width, int first) {
                constexpr int WIDE = decltype(width)::value;
                const BackwardRow<WIDE> part{shape, slope + size_t(y) * wide * outs,
                                             weights + size_t(row) * outs * run + first,
                                             out + size_t(y * shape.stride + row) * line + first};
                in_parts<(SUMS / WIDE > 16 ? 16 : SUMS / WIDE)>(int(wide), part);
            });
}

constexpr int DENSE_OUTS = SUMS / 4;
constexpr int DENSE_IMAGES = SUMS / DENSE_OUTS;

// Computes some features of some images: products are accumulated in vectors along the input, which are summed at the
// end.
template <int OUTS>
struct DenseForward {
    size_t flat, features, first;
    const float *read, *weights, *bias;
    float* hidden;

    template <int IMAGES>
    __attribute__((noinline)) void run(int begin) const {
        Register sums[IMAGES][OUTS];
        UNROLL for (int i = 0; i < IMAGES; ++i)
            UNROLL for (int o = 0; o < OUTS; ++o) sums[i][o] = Register{};
        const float *from = read + size_t(begin) * flat, *weight = weights + first * flat;
        for (size_t k = 0; k < flat; k += WIDTH) {
            Register x[IMAGES];
            UNROLL for (int i = 0; i < IMAGES; ++i) x[i] = get(from + size_t(i) * flat + k);
            UNROLL for (int o = 0; o < OUTS; ++o) {
                const Register w = get(weight + size_t(o) * flat + k);
                UNROLL for (int i = 0; i < IMAGES; ++i) sums[i][o] = sums[i][o] + w * x[i];
            }
        }
        for (int i = 0; i < IMAGES; ++i)
            for (int o = 0; o < OUTS; ++o)
                hidden[size_t(begin + i) * features + first + size_t(o)] =
                    std::max(total(sums[i][o]) + bias[first + size_t(o)], 0.0f);
    }
};

struct DenseForwards {
    size_t flat, features;
    const float *read, *weights, *bias;
    float* hidden;
    int count;

    template <int OUTS>
    void run(int first) const {
        in_parts<DENSE_IMAGES>(count, DenseForward<OUTS>{flat, features, size_t(first), read, weights, bias, hidden});
    }
};

static void forward(const TrunkShape& shape, const PackedTrunk& packed, const TrunkWeights& weights,
                    const float* images, size_t count, const TrunkLayers& layers) {
    const size_t flat = shape.flat();
    for (size_t i = 0; i < count; ++i) {
        float* between = layers.first + i * shape.first.written();
        convolve(shape.first, images + i * shape.first.read(), packed.first, weights.first_bias, between);
        convolve(shape.second, between, packed.second, weights.second_bias, layers.second + i * flat);
    }
    in_parts<DENSE_OUTS>(shape.features, DenseForwards{flat, size_t(shape.features), layers.second, weights.dense,
                                                       weights.dense_bias, layers.hidden, int(count)});
}

// Gradient before a ReLU: that after it, where the ReLU's output is positive.
LANE_INLINE void through(const float* after, float* slope, size_t count) {
    for (size_t i = 0; i < count; i += WIDTH) {
        const Register given = get(slope + i), passed = get(after + i);
        put(slope + i, passed > Register{} ? given : Register{});
    }
}

static void backward(const TrunkShape& shape, const PackedTrunk& packed, const TrunkWeights& weights,
                     const float* images, size_t count, const TrunkLayers& layers, const float* slope,
                     const TrunkGradients& gradients, float* scratch) {
    const size_t flat = shape.flat(), features = size_t(shape.features);
    float *second = scratch, *first = scratch + count * flat;
    in_strips(0, flat, int(count), [&](auto width, size_t k) {
        return Product<decltype(width)::value>{slope, weights.dense + k, 1, features, flat, features, flat, second + k};
    });
    through(layers.second, second, count * flat);
    for (size_t i = 0; i < count; ++i) {
        const float* between = layers.first + i * shape.first.written();
        add_gradients(shape.second, between, second + i * flat, gradients.second, gradients.second_bias);
        convolve_back(shape.second, second + i * flat, packed.second_back, first);
        through(between, first, shape.first.written());
        add_gradients(shape.first, images + i * shape.first.read(), first, gradients.first, gradients.first_bias);
    }
}

static void dense_gradient(const TrunkShape& shape, const float* read, const float* slope, size_t count, size_t begin,
                           size_t end, float* out) {
    const size_t flat = shape.flat(), features = size_t(shape.features);
    in_strips(begin, end, shape.features, [&](auto width, size_t k) {
        return Product<decltype(width)::value>{slope, read + k, features, 1, flat, count, flat, out + k};
    });
}

extern const TrunkKernels trunk_kernels = {forward, backward, dense_gradient};

}  // namespace SPLATRL_ISA
}  // namespace splatrl
