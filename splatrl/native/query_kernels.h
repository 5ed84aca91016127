// Collision queries on a CPU, many poses at a time, compiled for each instruction set. All sets give the same answers.
#pragma once

#include "collision_grid.h"
#include "collision_shape.h"
#include "isa.h"

namespace splatrl {

// More informative balls than those about the origin: COUNT balls inside a body, as far from its middle as possible,
// then COUNT that cover it. If one of the former surely touches something, so does the body; if all of the latter are
// free, so is the body.
struct Balls {
    static constexpr int COUNT = 4;  // of each kind
    bool some;                       // whether there are any; not if the body is a ball
    double within, around;           // radii of the balls inside, and of those that cover the body
    alignas(64) double at[3][2 * COUNT];  // centres, by axis
};

inline Balls balls_in(const Shape& shape) {
    Balls out{shape.outer > shape.inner, shape.inner, 0.0, {}};
    const double along[] = {-1.0, -0.5, 0.5, 1.0}, quarters[] = {-0.75, -0.25, 0.25, 0.75};
    if (shape.kind == Shape::CAPSULE) {
        out.around = shape.radius + 0.25 * shape.half_length;
        for (int i = 0; i < Balls::COUNT; ++i) {
            out.at[2][i] = along[i] * shape.half_length;
            out.at[2][Balls::COUNT + i] = quarters[i] * shape.half_length;
        }
    }
    if (shape.kind == Shape::BOX) {
        const Vec3& half = shape.half;
        const int longest = half[0] >= half[1] ? (half[0] >= half[2] ? 0 : 2) : (half[1] >= half[2] ? 1 : 2);
        const int a = (longest + 1) % 3, b = (longest + 2) % 3, second = half[a] >= half[b] ? a : b;
        Vec3 piece = half;  // a quarter of the box, cut along its longest side or its two longest
        piece[longest] *= 0.5;
        piece[second] *= 0.5;
        const bool in_a_row = 0.5 * half[longest] >= 2.0 * half[second];
        if (in_a_row) {
            piece[longest] *= 0.5;
            piece[second] *= 2.0;
        }
        out.around = norm(piece);
        for (int i = 0; i < Balls::COUNT; ++i) {
            const double x = i & 1 ? 1.0 : -1.0, y = i & 2 ? 1.0 : -1.0, signs[3] = {x, y, x * y};
            for (int axis = 0; axis < 3; ++axis) out.at[axis][i] = signs[axis] * (half[axis] - shape.inner);
            out.at[longest][Balls::COUNT + i] = in_a_row ? quarters[i] * half[longest] : 0.5 * x * half[longest];
            if (!in_a_row) out.at[second][Balls::COUNT + i] = 0.5 * y * half[second];
        }
    }
    return out;
}

// A grid and a body in it; the body's lengths are in voxels of that grid.
struct Fitted {
    Grid grid;
    Shape shape;
    Balls balls;
};

// The grids that the queries of a batch ask.
struct Asked {
    const Fitted* const* fitted;
    size_t count;
    const int64_t* places;  // index of each query's grid, in [0, count); null if all ask the first

    bool knows(size_t i) const { return places == nullptr || uint64_t(places[i]) < count; }
    const Fitted& operator()(size_t i) const { return *fitted[places == nullptr ? 0 : places[i]]; }
};

// Each kernel answers the queries [begin, end) of a batch, whose poses are row-major 4×4 matrices. It returns `end`, or
// the first query whose grid does not exist or whose pose is not rigid; in that case answers are missing.
struct QueryKernels {
    size_t (*collides)(const Asked&, const float* poses, bool* hits, size_t begin, size_t end);
    size_t (*sweeps)(const Asked&, const float* starts, const float* ends, bool* hits, size_t begin, size_t end);
    size_t (*free_fraction)(const Asked&, const float* starts, const float* ends, float* shares, size_t begin,
                            size_t end);
};

namespace portable { extern const QueryKernels query_kernels; }
namespace avx2 { extern const QueryKernels query_kernels; }
namespace avx512 { extern const QueryKernels query_kernels; }

const QueryKernels& query_kernels_of(Isa isa);

}  // namespace splatrl
