// Searches for the first contact of a shape on a straight way with a whole warp, 32 columns at a time.
#pragma once

#include "first_contact.h"
#include "platform.h"

namespace splatrl {

constexpr int AT_ONCE = 4;  // columns that a lane reads together, to hide the latency of memory

// What a warp keeps in shared memory, including values that are the same for all lanes, because registers are scarce.
struct Search {
    Normal normals[NORMALS];
    int waiting[(AT_ONCE + 1) * WARP];  // columns with something solid, in the order in which they were found
    Pose start, end;                    // of the query
    BoxWay box;
    BoxSweep sweep;
};

// The smallest result of contact(column) over all columns with something solid; stops at 0. If there are any, the whole
// warp first calls prepare() once. Few columns hold something solid, so these are collected before they are searched,
// one per lane.
template <class Prepare, class Contact>
SPLAT_INLINE double first_by_warp(const Columns& columns, int* waiting, const Prepare& prepare,
                                  const Contact& contact) {
    const int along_y = columns.along_y(), count = columns.along_x() * along_y;
    const auto column = [&](int i) {
        return columns.column(from_middle(columns.xs, i / along_y), from_middle(columns.ys, i % along_y));
    };
    double first = NEVER;
    bool prepared = false;
    int found = 0;
    for (int begin = 0; begin < count; begin += AT_ONCE * WARP) {
        bool solid[AT_ONCE];
#pragma unroll
        for (int i = 0; i < AT_ONCE; ++i) {
            const int mine = begin + i * WARP + lane();
            solid[i] = mine < count && columns.any_solid_in(column(mine));
        }
#pragma unroll
        for (int i = 0; i < AT_ONCE; ++i) {
            const unsigned lanes = __ballot_sync(ALL_LANES, solid[i]);
            if (solid[i]) waiting[found + rank_in(lanes)] = begin + i * WARP + lane();
            found += __popc(lanes);
        }
        if (found == 0) continue;
        __syncwarp();
        if (!prepared) prepare();
        prepared = true;
        const bool last = begin + AT_ONCE * WARP >= count;
        int done = 0;
        for (; done + WARP <= found || (last && done < found); done += WARP) {
            if (done + lane() < found) first = min(first, contact(column(waiting[done + lane()])));
            if (__any_sync(ALL_LANES, first == 0.0)) return 0.0;
        }
        found = max(found - done, 0);  // fewer than a warp's lanes; they come first next time
        const int left = lane() < found ? waiting[done + lane()] : 0;
        __syncwarp();
        if (lane() < found) waiting[lane()] = left;
    }
    for (int lanes = WARP / 2; lanes > 0; lanes /= 2) first = min(first, __shfl_xor_sync(ALL_LANES, first, lanes));
    return first;
}

// The `contact` of collision.h, computed by a warp: all lanes pass the same arguments and get the same result.
struct WarpContact {
    const Grid& grid;
    Search& search;

    HOST_DEVICE double operator()(const Shape& shape, const Pose& pose, const Vec3& way, bool any) const {
        const Columns columns = columns_on_way(grid, shape, pose, way);
        __syncwarp();  // no lane still reads what the last search left behind
        if (shape.kind != Shape::BOX) {
            const RoundSweep sweep = round_sweep(shape, pose, way);
            return first_by_warp(
                columns, search.waiting, [] {}, [&](const Column& column) { return sweep.contact(column, any); });
        }
        if (lane() == 0) {
            search.box = box_way(shape, pose, way);
            search.sweep = {pose.position, along(pose.position, way, 0.5), search.normals, 0};
        }
        __syncwarp();
        return first_by_warp(
            columns, search.waiting, [&] { write_normals(); },
            [&](const Column& column) { return search.sweep.contact(column, any); });
    }

    // Every lane makes one normal.
    HOST_DEVICE void write_normals() const {
        Normal normal;
        const bool made = lane() < search.box.normals && make_normal(search.box, lane(), normal);
        const unsigned lanes = __ballot_sync(ALL_LANES, made);
        if (made) search.normals[rank_in(lanes)] = normal;
        if (lane() == 0) search.sweep.count = __popc(lanes);
        __syncwarp();
    }
};

}  // namespace splatrl
