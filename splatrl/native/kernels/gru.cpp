// Kernels of a gated recurrent unit, compiled once for each instruction set. Episodes take their steps side by side, so
// that a weight that is read once serves several of them.
#include "gru.h"

#include <algorithm>
#include <cstring>

#include "kernels/products.h"

namespace splatrl {
namespace SPLATRL_ISA {

constexpr size_t PACKED = STRIP * WIDTH;  // gates that are computed together
constexpr size_t FRAMES = 64;             // frames of a sum that fit into the first-level cache with what they read

// e^a to the last bit or two; a beyond the range of normal numbers counts as its end.
LANE_INLINE Register exponential(const Register& a) {
    constexpr float ROUND = 12582912.0f;  // 1.5 · 2^23: adding it rounds to an integer in the lowest bits
    const Register least = splat_part(-87.0f), most = splat_part(88.0f);
    const Register low = a < least ? least : a, x = low > most ? most : low;
    const Register shifted = x * 1.44269504f + ROUND, whole = shifted - ROUND;
    const Register f = (x - whole * 0.693359375f) + whole * 2.12194440e-4f;
    const Register power =
        (((((1.9875691e-4f * f + 1.3981999e-3f) * f + 8.3334519e-3f) * f + 4.1665796e-2f) * f + 1.6666665e-1f) * f +
         5.0000001e-1f) * (f * f) + f + 1.0f;
    return (Register)((UnsignedPart)power + ((UnsignedPart)shifted << 23));
}

LANE_INLINE Register sigmoid(const Register& a) { return 1.0f / (1.0f + exponential(-a)); }

LANE_INLINE Register hyperbolic_tangent(const Register& a) {
    const Register q = a * a, bound = splat_part(0.390625f);  // of |a| = 0.625, below which 1 - 2 / ... loses digits
    const Register small =
        ((((-5.7049887e-3f * q + 2.0639088e-2f) * q - 5.3739716e-2f) * q + 1.3331442e-1f) * q - 3.3333282e-1f) * q * a +
        a;
    const Register large = 1.0f - 2.0f / (exponential(2.0f * a) + 1.0f);
    return q < bound ? small : large;
}

static void pack(const float* weights, size_t gates, size_t in, float* out) {
    for (size_t strip = 0; strip < gates; strip += PACKED, out += in * PACKED)
        for (size_t begin = 0; begin < in; begin += GRU_LANES)  // in blocks, so that lines of the cache are read once
            for (size_t gate = 0; gate < PACKED; ++gate)
                for (size_t k = begin; k < begin + GRU_LANES; ++k)
                    out[k * PACKED + gate] = weights[(strip + gate) * in + k];
}

// out[row, gates] = packed weights · read[row, in]
static void gates_of(const float* packed, const float* read, size_t in, size_t rows, size_t gates, float* out,
                     size_t out_step) {
    for (size_t strip = 0; strip < gates; strip += PACKED, packed += in * PACKED)
        in_parts<STRIP_ROWS>(int(rows), Product<STRIP>{read, packed, 1, in, PACKED, in, out_step, out + strip});
}

static void input(const GruShape& shape, const float* packed, const float* features, size_t count, float* kept) {
    gates_of(packed, features, shape.features, count, shape.gates(), kept, shape.kept());
}

// Number of episodes with more than `step` steps.
static size_t active(const Episode* episodes, size_t count, size_t step) {
    while (count > 0 && episodes[count - 1].length <= step) --count;
    return count;
}

static void forward(const GruShape& shape, const float* packed, const GruWeights& weights, const Episode* episodes,
                    size_t count, float* hidden, float* kept, float* scratch) {
    const size_t units = shape.memory;
    float *states = scratch, *gates = scratch + count * units;
    for (size_t e = 0; e < count; ++e) std::memcpy(states + e * units, episodes[e].state, sizeof(float) * units);
    for (size_t step = 0; (count = active(episodes, count, step)) > 0; ++step) {
        gates_of(packed, states, units, count, shape.gates(), gates, shape.gates());
        for (size_t e = 0; e < count; ++e) {
            const size_t frame = episodes[e].begin + step;
            float *state = states + e * units, *mine = kept + frame * shape.kept(), *out = hidden + frame * units;
            const float* by_state = gates + e * shape.gates();
            for (size_t u = 0; u < units; u += WIDTH) {
                const auto gate = [&](size_t number, size_t at) {
                    return get(mine + number * units + u) + get(weights.input_bias + number * units + u) +
                           (get(by_state + at) + get(weights.recurrent_bias + at));
                };
                const Register reset = sigmoid(gate(0, u)), update = sigmoid(gate(1, units + u));
                const Register recalled = get(by_state + 2 * units + u) + get(weights.recurrent_bias + 2 * units + u);
                const Register fresh = hyperbolic_tangent(
                    get(mine + 2 * units + u) + get(weights.input_bias + 2 * units + u) + reset * recalled);
                const Register before = get(state + u), after = fresh + update * (before - fresh);
                put(mine + u, reset);
                put(mine + units + u, update);
                put(mine + 2 * units + u, fresh);
                put(mine + 3 * units + u, recalled);
                put(mine + 4 * units + u, before);
                put(state + u, after);
                put(out + u, after);
            }
        }
    }
}

static void backward(const GruShape& shape, const GruWeights& weights, const Episode* episodes, size_t count,
                     const float* kept, const float* hidden_slope, float* slopes, float* scratch) {
    const size_t units = shape.memory;
    float *carried = scratch, *gates = scratch + count * units;  // gradients of states, and of their part of the gates
    std::memset(carried, 0, sizeof(float) * count * units);
    for (size_t step = count > 0 ? episodes[0].length : 0; step-- > 0;) {
        const size_t some = active(episodes, count, step);
        for (size_t e = 0; e < some; ++e) {
            const size_t frame = episodes[e].begin + step;
            const float *mine = kept + frame * shape.kept(), *given = hidden_slope + frame * units;
            float *to = slopes + frame * shape.slopes(), *carry = carried + e * units,
                *by_state = gates + e * shape.gates();
            for (size_t u = 0; u < units; u += WIDTH) {
                const Register reset = get(mine + u), update = get(mine + units + u), fresh = get(mine + 2 * units + u);
                const Register recalled = get(mine + 3 * units + u), before = get(mine + 4 * units + u);
                const Register slope = get(given + u) + get(carry + u);
                const Register by_new = slope * (1.0f - update) * (1.0f - fresh * fresh);
                const Register by_reset = by_new * recalled * reset * (1.0f - reset);
                const Register by_update = slope * (before - fresh) * update * (1.0f - update);
                const Register by_recalled = by_new * reset;
                put(to + u, by_new);
                put(to + units + u, by_reset);
                put(to + 2 * units + u, by_update);
                put(to + 3 * units + u, by_recalled);
                put(by_state + u, by_reset);
                put(by_state + units + u, by_update);
                put(by_state + 2 * units + u, by_recalled);
                put(carry + u, slope * update);
            }
        }
        if (step > 0)
            in_strips(0, units, int(some), [&](auto width, size_t k) {
                return Product<decltype(width)::value>{gates, weights.recurrent + k, 1, shape.gates(), units,
                                                       shape.gates(), units, carried + k, true};
            });
    }
}

static void input_gradient(const GruShape& shape, const GruWeights& weights, const float* slopes, size_t count,
                           float* out) {
    const size_t units = shape.memory, in = shape.features, step = shape.slopes();
    const float* of_new = weights.input + 2 * units * in;
    in_strips(0, in, int(count), [&](auto width, size_t k) {
        return Product<decltype(width)::value>{slopes, of_new + k, 1, step, in, units, in, out + k};
    });
    in_strips(0, in, int(count), [&](auto width, size_t k) {
        return Product<decltype(width)::value>{slopes + units, weights.input + k, 1, step, in, 2 * units, in, out + k,
                                               true};
    });
}

static void weight_gradient(const float* slopes, size_t step, const float* read, size_t read_step, size_t count,
                            size_t rows, size_t columns, float* out) {
    for (size_t begin = 0; begin < count; begin += FRAMES) {
        const size_t some = std::min(count - begin, FRAMES);
        in_strips(0, columns, int(rows), [&](auto width, size_t k) {
            return Product<decltype(width)::value>{slopes + begin * step, read + begin * read_step + k, step, 1,
                                                   read_step, some, columns, out + k, begin > 0};
        });
    }
}

extern const GruKernels gru_kernels = {pack, input, forward, backward, input_gradient, weight_gradient};

}  // namespace SPLATRL_ISA
}  // namespace splatrl
