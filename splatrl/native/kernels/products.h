// Products of small matrices whose sums are kept in registers, as many as there are, so that a number that is read once
// serves several rows.
#pragma once

#include "kernels/registers.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Sums that fit into the registers beside their operands.
#if defined(SPLATRL_AVX512)
constexpr int SUMS = 24;
#else
constexpr int SUMS = 12;
#endif

#define UNROLL _Pragma("GCC unroll 32")

// Call work.template run<size>(begin), with the size, from 1 to MOST, as a template argument.
template <int MOST, class Work>
LANE_INLINE void in_parts_of(int count, int size, int begin, const Work& work) {
    if constexpr (MOST > 0) {
        if (size == MOST)
            work.template run<MOST>(begin);
        else
            in_parts_of<MOST - 1>(count, size, begin, work);
    }
}

// Split [0, count) into parts of at most MOST, as evenly as possible, and call work.template run<size>(begin) for each.
template <int MOST, class Work>
LANE_INLINE void in_parts(int count, const Work& work) {
    const int parts = (count + MOST - 1) / MOST;
    for (int part = 0, begin = 0; part < parts; ++part) {
        const int size = (count - begin + parts - part - 1) / (parts - part);
        in_parts_of<MOST>(count, size, begin, work);
        begin += size;
    }
}

template <int REGISTERS>
struct Width {
    static constexpr int value = REGISTERS;
};

constexpr int STRIP = 3;  // registers of a strip of columns
constexpr int STRIP_ROWS = SUMS / STRIP;

// out[r, strip] = sum over n of factors[n, r] · columns[n, strip], added to what is there if `more`. The order of a sum
// does not depend on which rows and strips are computed together.
template <int WIDE>
struct Product {
    const float *factors, *columns;
    size_t factor_step, factor_row, column_step, terms, out_step;
    float* out;
    bool more = false;

    template <int ROWS>
    __attribute__((noinline)) void run(int begin) const {
        Register sums[ROWS][WIDE];
        UNROLL for (int r = 0; r < ROWS; ++r)
            UNROLL for (int v = 0; v < WIDE; ++v)
                sums[r][v] = more ? get(out + size_t(begin + r) * out_step + v * WIDTH) : Register{};
        const float *factor = factors + size_t(begin) * factor_row, *column = columns;
        for (size_t n = 0; n < terms; ++n, factor += factor_step, column += column_step) {
            Register c[WIDE];
            UNROLL for (int v = 0; v < WIDE; ++v) c[v] = get(column + v * WIDTH);
            UNROLL for (int r = 0; r < ROWS; ++r)
                UNROLL for (int v = 0; v < WIDE; ++v) sums[r][v] = sums[r][v] + c[v] * factor[size_t(r) * factor_row];
        }
        UNROLL for (int r = 0; r < ROWS; ++r)
            UNROLL for (int v = 0; v < WIDE; ++v) put(out + size_t(begin + r) * out_step + v * WIDTH, sums[r][v]);
    }
};

// Run the product that make(Width<N>(), k) returns over all rows, for strips of N registers that cover [begin, end).
template <class Make>
LANE_INLINE void in_strips(size_t begin, size_t end, int rows, const Make& make) {
    size_t k = begin;
    for (; k + STRIP * WIDTH <= end; k += STRIP * WIDTH) in_parts<STRIP_ROWS>(rows, make(Width<STRIP>(), k));
    for (; k + 2 * WIDTH <= end; k += 2 * WIDTH) in_parts<STRIP_ROWS>(rows, make(Width<2>(), k));
    for (; k < end; k += WIDTH) in_parts<STRIP_ROWS>(rows, make(Width<1>(), k));
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
