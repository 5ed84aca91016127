// Tests thousands of bodies against a grid at once. A block takes some queries. Its threads first look up one pose each
// in the distance field, and whether some points inside the body are solid. That settles most of them; those that it
// leaves open are collected. The warps then take these one at a time, and all lanes search the voxels around the body
// together. An answer depends neither on other queries
// nor on their order or the batch.
//
// The macro BODY_KIND is a Shape::Kind, so that each kind is compiled separately. An invalid pose is recorded in
// `fault` and counts as a hit.
#include "platform.h"

#include "collision.h"
#include "inside.h"
#include "rays.h"
#include "rigid.h"
#include "warp_contact.h"

namespace splatrl {

constexpr int MOST_OPEN = 1024, WARPS = BLOCK_THREADS / WARP;

// The queries of a launch, with poses as row-major 4×4 matrices, and where the answers go.
struct Queries {
    const float *start, *end;
    bool* hits;        // whether anything is touched; null if free fractions are asked for
    float* fractions;  // free fractions of moves; null if hits are asked for
    int* fault;        // the lowest row that was refused
    int count;
    int at_once;  // queries per block, a multiple of WARP and at most MOST_OPEN
};

struct Shared {
    Search searches[WARPS];
    int open[MOST_OPEN];
    int found, taken;
};

// Call settled(row) for every row, with one thread each, and answer(row, search) for the rows where it returns false,
// with one warp each.
template <class Settled, class Answer>
SPLAT_INLINE void each_query(const Queries& queries, const Settled& settled, const Answer& answer) {
    __shared__ Shared shared;
    Search& search = shared.searches[threadIdx.x / WARP];
    for (int64_t first = int64_t(blockIdx.x) * queries.at_once; first < queries.count;
         first += int64_t(gridDim.x) * queries.at_once) {
        const int count = min(queries.at_once, int(queries.count - first));
        if (threadIdx.x == 0) shared.found = shared.taken = 0;
        __syncthreads();
        for (int begin = int(threadIdx.x) - lane(); begin < count; begin += BLOCK_THREADS) {
            const int mine = begin + lane();
            const unsigned open = __ballot_sync(ALL_LANES, mine < count && !settled(int(first) + mine));
            int place = 0;
            if (lane() == 0 && open != 0) place = atomicAdd(&shared.found, __popc(open));
            place = __shfl_sync(ALL_LANES, place, 0) + rank_in(open);
            if (open >> lane() & 1u) shared.open[place] = mine;
        }
        __syncthreads();
        for (;;) {
            int next = 0;
            if (lane() == 0) next = atomicAdd(&shared.taken, 1);
            next = __shfl_sync(ALL_LANES, next, 0);
            if (next >= shared.found) break;
            answer(int(first) + shared.open[next], search);
        }
        __syncthreads();
    }
}

// Lidar beams of a batch of bodies: ray i is beam i % along of body i / along.
struct Beams {
    const float *poses, *ways;  // [count, 4, 4], [along, 3] in the frame of each body
    int* fault;                 // the lowest body that was refused
    int along, count;
};

// Distance in metres from a body along one of its beams to the first solid voxel, at most `reach`.
HOST_DEVICE inline double range_of(const RayGrid& grid, const float* pose, const float* beam, double reach) {
    RayAxis<double> axes[3];
    double squares = 0.0, t = 0.0, last = reach * grid.inverse;
    for (int i = 0; i < 3; ++i) {
        const float* row = pose + 4 * i;
        axes[i].from = (double(row[3]) - grid.corner[i]) * grid.inverse;
        axes[i].way = double(row[0]) * beam[0] + double(row[1]) * beam[1] + double(row[2]) * beam[2];
        squares += axes[i].way * axes[i].way;
    }
    for (int i = 0; i < 3; ++i) {
        axes[i].way /= sqrt(squares);
        axes[i].inverse = inverse_of(axes[i].way);
        clip(axes[i], double(grid.size[i]), t, last);
    }
    for (int i = 0; i < 3; ++i) axes[i].index = index_at(axes[i], t, 0.0, double(grid.size[i] - 1));
    for (bool ahead = t < last; ahead;) {
        const size_t layer = size_t(axes[2].index) * grid.size[0] + size_t(axes[0].index);
        const double room = grid.room[layer * grid.size[1] + size_t(axes[1].index)];
        if (room == 0.0) return min(t * grid.resolution, reach);
        ahead = advance(axes, room, grid.size, last, t);
    }
    return reach;
}

struct Matrix {
    float at[16];
};

SPLAT_INLINE Matrix matrix_in(const float* poses, int row) {
    const float4* quarters = reinterpret_cast<const float4*>(poses) + 4 * size_t(row);
    Matrix out;
    for (int i = 0; i < 4; ++i) {
        const float4 quarter = quarters[i];
        out.at[4 * i] = quarter.x, out.at[4 * i + 1] = quarter.y;
        out.at[4 * i + 2] = quarter.z, out.at[4 * i + 3] = quarter.w;
    }
    return out;
}

SPLAT_INLINE bool same_rotation(const Matrix& a, const Matrix& b) {
    bool out = true;
    for (int i = 0; i < 12; ++i) out = out && (i % 4 == 3 || a.at[i] == b.at[i]);
    return out;
}

SPLAT_INLINE Shape of_this_kind(Shape shape) {
    shape.kind = Shape::Kind(BODY_KIND);
    return shape;
}

}  // namespace splatrl

using namespace splatrl;

extern "C" __global__ void __launch_bounds__(BLOCK_THREADS, BLOCKS_A_MULTIPROCESSOR)
    find_hits(Grid grid, Shape body, Queries queries) {
    const Shape shape = of_this_kind(body);
    const auto settled = [&](int row) {
        const Matrix pose = matrix_in(queries.start, row);
        const bool right = is_pose(pose.at);
        if (!right) atomicMin(queries.fault, row);
        const Vec3 position = position_of(grid, pose.at);
        Verdict verdict = right ? judge(grid, shape, position) : Verdict::HIT;
        if (verdict == Verdict::MAYBE && holds_solid(grid, shape, pose.at, position)) verdict = Verdict::HIT;
        if (verdict != Verdict::MAYBE) queries.hits[row] = verdict == Verdict::HIT;
        return verdict != Verdict::MAYBE;
    };
    const auto answer = [&](int row, Search& search) {
        const Pose pose = pose_of(grid, matrix_in(queries.start, row).at);
        const bool hit = touches(shape, pose, WarpContact{grid, search});
        if (lane() == 0) queries.hits[row] = hit;
    };
    each_query(queries, settled, answer);
}

// One kernel for both hits and free fractions of moves, because the code that it calls takes seconds to compile.
extern "C" __global__ void __launch_bounds__(BLOCK_THREADS, BLOCKS_A_MULTIPROCESSOR)
    follow_moves(Grid grid, Shape body, Queries queries) {
    const Shape shape = of_this_kind(body);
    const bool any = queries.hits != nullptr;
    const auto write = [&](int row, double free) {
        if (any)
            queries.hits[row] = free < 1.0;
        else
            queries.fractions[row] = rounded_down(free);
    };
    // Whether a point inside the body is solid at the start or, if that suffices, at the end or halfway.
    const auto hits = [&](int row, bool turns, const Vec3& from, const Vec3& way) {
        const int places = !any ? 1 : turns ? 2 : 3;
#pragma unroll 1
        for (int i = 0; i < places; ++i) {
            const float* pose = (i == 1 ? queries.end : queries.start) + 16 * size_t(row);
            if (holds_solid(grid, shape, pose, along(from, way, i == 0 ? 0.0 : 1.0 / i))) return true;
        }
        return false;
    };
    const auto settled = [&](int row) {
        const Matrix start = matrix_in(queries.start, row), end = matrix_in(queries.end, row);
        const bool right = is_pose(start.at) && is_pose(end.at);
        if (!right) atomicMin(queries.fault, row);
        const Vec3 from = position_of(grid, start.at), way = between(from, position_of(grid, end.at));
        const bool passed = right && passes(grid, shape, from, way);
        const bool hit = !right || (!passed && hits(row, !same_rotation(start, end), from, way));
        if (passed || hit) write(row, passed ? 1.0 : 0.0);
        return passed || hit;
    };
    const auto answer = [&](int row, Search& search) {
        __syncwarp();
        if (lane() == 0) search.start = pose_of(grid, matrix_in(queries.start, row).at);
        if (lane() == 1) search.end = pose_of(grid, matrix_in(queries.end, row).at);
        __syncwarp();
        const double free = free_fraction(grid, shape, search.start, search.end, any, WarpContact{grid, search});
        if (lane() == 0) write(row, free);
    };
    each_query(queries, settled, answer);
}

// Computes the clearances of points [count, 3], both in metres.
extern "C" __global__ void find_clearances(Grid grid, const float* points, int* fault, int count, float* metres) {
    for (int64_t row = int64_t(blockIdx.x) * blockDim.x + threadIdx.x; row < count;
         row += int64_t(gridDim.x) * blockDim.x) {
        const float *point = points + 3 * row;
        const float x = point[0], y = point[1], z = point[2];
        const bool right = 0.0f * x + 0.0f * y + 0.0f * z == 0.0f;  // finite
        if (!right) atomicMin(fault, int(row));
        metres[row] = right ? clearance_in_metres(grid, place_of(grid, x, y, z)) : 0.0f;
    }
}

// Computes the ranges [bodies, along], in metres.
extern "C" __global__ void find_ranges(RayGrid grid, Beams beams, double reach, float* metres) {
    const int64_t count = int64_t(beams.count) * beams.along;
    for (int64_t ray = int64_t(blockIdx.x) * blockDim.x + threadIdx.x; ray < count;
         ray += int64_t(gridDim.x) * blockDim.x) {
        const int body = int(ray / beams.along);
        const float* pose = beams.poses + 16 * size_t(body);
        const float* beam = beams.ways + 3 * (ray % beams.along);
        const float off = beam[0] * beam[0] + beam[1] * beam[1] + beam[2] * beam[2] - 1.0f;
        const bool right = is_pose(pose) && fabs(off) <= 3.0f * ORTHONORMAL;  // false for NaN, too
        if (!right) atomicMin(beams.fault, body);
        metres[ray] = right ? float(range_of(grid, pose, beam, reach)) : 0.0f;
    }
}
