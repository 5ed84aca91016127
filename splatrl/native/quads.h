// Four floats as one value, for work that is done four at a time with every instruction set.
#pragma once

#include <cstdint>

#include "inline.h"

namespace splatrl {

typedef float Quad __attribute__((vector_size(16)));
typedef int32_t QuadIndex __attribute__((vector_size(16)));

// Select four numbers from two quads by position: 0 to 3 in the first, 4 to 7 in the second.
#if defined(__clang__)
#define PICK(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define PICK(a, b, ...) __builtin_shuffle(a, b, QuadIndex{__VA_ARGS__})
#endif

// Transpose a 4×4 matrix.
SPLAT_INLINE void turn_quads(Quad (&rows)[4]) {
    const Quad low_ab = PICK(rows[0], rows[1], 0, 4, 1, 5), low_cd = PICK(rows[2], rows[3], 0, 4, 1, 5);
    const Quad high_ab = PICK(rows[0], rows[1], 2, 6, 3, 7), high_cd = PICK(rows[2], rows[3], 2, 6, 3, 7);
    rows[0] = PICK(low_ab, low_cd, 0, 1, 4, 5), rows[1] = PICK(low_ab, low_cd, 2, 3, 6, 7);
    rows[2] = PICK(high_ab, high_cd, 0, 1, 4, 5), rows[3] = PICK(high_ab, high_cd, 2, 3, 6, 7);
}

}  // namespace splatrl
