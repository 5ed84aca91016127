// Casts many lidar beams at once, compiled once for each instruction set.
#include "ray_kernels.h"

#include <cmath>

#include "doubles.h"

namespace splatrl {
namespace SPLATRL_ISA {

constexpr int LANES = 16;  // rays that advance side by side, so that their memory accesses overlap
constexpr int PARTS = LANES / WIDTH;
constexpr int AT_ONCE = 512;  // rays that are prepared together

template <int COUNT>
struct alignas(64) Rays {
    double t[COUNT], last[COUNT];  // voxels: how far along a ray is, and where it ends
    double from[3][COUNT], way[3][COUNT], inverse[3][COUNT], index[3][COUNT];
};

template <int COUNT>
static inline RayAxis<Part> axis_of(const Rays<COUNT>& rays, int axis, int first) {
    return {load(rays.from[axis] + first), load(rays.way[axis] + first), load(rays.inverse[axis] + first),
            load(rays.index[axis] + first)};
}

// Prepare rays, each at the point where it enters the grid.
static void prepare(const RayGrid& grid, const Beams& beams, size_t begin, int count, double reach,
                    Rays<AT_ONCE>& rays) {
    for (int i = 0; i < count; ++i) {
        const float* pose = beams.poses + 16 * ((begin + i) / beams.along);
        const float* beam = beams.ways + 3 * ((begin + i) % beams.along);
        for (int axis = 0; axis < 3; ++axis) {
            const float* row = pose + 4 * axis;
            rays.from[axis][i] = (double(row[3]) - grid.corner[axis]) * grid.inverse;
            rays.way[axis][i] = double(row[0]) * beam[0] + double(row[1]) * beam[1] + double(row[2]) * beam[2];
        }
    }
    for (int first = 0; first < count; first += WIDTH) {
        Part squares{}, length, t{}, last = reach + Part{};
        for (int axis = 0; axis < 3; ++axis) {
            const Part way = load(rays.way[axis] + first);
            squares += way * way;
        }
        for (int i = 0; i < WIDTH; ++i) length[i] = std::sqrt(squares[i]);
        for (int axis = 0; axis < 3; ++axis) {
            const Part way = load(rays.way[axis] + first) / length;  // removes the rotation's rounding error
            store(rays.way[axis] + first, way);
            store(rays.inverse[axis] + first, inverse_of(way));
            clip(axis_of(rays, axis, first), grid.size[axis], t, last);
        }
        for (int axis = 0; axis < 3; ++axis) {
            const Part highest = double(grid.size[axis] - 1) + Part{};
            store(rays.index[axis] + first, index_at(axis_of(rays, axis, first), t, Part{}, highest));
        }
        store(rays.t + first, t);
        store(rays.last + first, last);
    }
}

// Rays in flight, one per lane. A lane whose ray has ended takes the next waiting one.
struct Flight {
    const RayGrid& grid;
    const Rays<AT_ONCE>& waiting;
    const double nowhere;  // stands for the voxel of a ray that has ended: its room is 0
    int count, next = 0, open = 0;
    Rays<LANES> rays{};
    Part room[PARTS]{};
    int which[LANES]{};
    bool ends = false;  // whether the ray of some lane has no room, and so has ended

    void take(int lane) {
        const int ray = next < count ? next : count - 1;  // an idle lane repeats the last ray; its result is ignored
        which[lane] = next < count ? next : -1;
        open += next < count;
        ++next;
        rays.t[lane] = waiting.t[ray];
        rays.last[lane] = waiting.last[ray];
        for (int axis = 0; axis < 3; ++axis) {
            rays.from[axis][lane] = waiting.from[axis][ray];
            rays.way[axis][lane] = waiting.way[axis][ray];
            rays.inverse[axis][lane] = waiting.inverse[axis][ray];
            rays.index[axis][lane] = waiting.index[axis][ray];
        }
    }

    // Look up the room of the rays' voxels. Doubles from 2^52 on are integers, held in their lower bits.
    void look(int first, const Part& places) {
        constexpr double WHOLE = 4503599627370496.0;
        constexpr int64_t LOW = (int64_t(1) << 52) - 1;
        const Part shifted = places + WHOLE;
        const Mask offsets = (Mask)shifted & LOW;
        Part found;
        for (int i = 0; i < WIDTH; ++i) {
            const int here = grid.room[offsets[i]];
            ends |= here == 0;
            found[i] = here;
        }
        room[first / WIDTH] = found;
    }

    Part places(const Part (&index)[3], const Mask& ahead) const {
        const Part place = (index[2] * double(grid.size[0]) + index[0]) * double(grid.size[1]) + index[1];
        return ahead ? place : nowhere + Part{};
    }

    void look_all() {
        ends = false;
        for (int first = 0; first < LANES; first += WIDTH) {
            const Part index[3] = {load(rays.index[0] + first), load(rays.index[1] + first),
                                   load(rays.index[2] + first)};
            look(first, places(index, load(rays.t + first) < load(rays.last + first)));
        }
    }

    void go_on() {
        ends = false;
        for (int first = 0; first < LANES; first += WIDTH) {
            RayAxis<Part> axes[3];
            for (int axis = 0; axis < 3; ++axis) axes[axis] = axis_of(rays, axis, first);
            Part t;
            const Mask ahead = advance(axes, room[first / WIDTH], grid.size, load(rays.last + first), t);
            store(rays.t + first, ahead ? t : ALONG_A_PLANE + Part{});
            for (int axis = 0; axis < 3; ++axis) store(rays.index[axis] + first, axes[axis].index);
            look(first, places({axes[0].index, axes[1].index, axes[2].index}, ahead));
        }
    }
};

static void fly(const RayGrid& grid, const Rays<AT_ONCE>& waiting, int count, double reach, float* metres) {
    Flight flight{grid, waiting, double(grid.size[0]) * grid.size[1] * grid.size[2], count};
    for (int lane = 0; lane < LANES; ++lane) flight.take(lane);
    flight.look_all();
    for (;;) {
        while (flight.ends) {
            bool taken = false;
            for (int lane = 0; lane < LANES; ++lane) {
                if (flight.which[lane] < 0 || flight.room[lane / WIDTH][lane % WIDTH] != 0.0) continue;
                const double t = flight.rays.t[lane], found = t * grid.resolution;
                metres[flight.which[lane]] = float(t < flight.rays.last[lane] && found < reach ? found : reach);
                --flight.open;
                flight.take(lane);
                taken = true;
            }
            if (!taken) break;
            flight.look_all();
        }
        if (flight.open == 0) return;
        flight.go_on();
    }
}

static void cast(const RayGrid& grid, const Beams& beams, size_t begin, size_t count, double reach, float* metres) {
    Rays<AT_ONCE> rays{};
    for (size_t done = 0; done < count; done += AT_ONCE) {
        const int some = int(count - done < AT_ONCE ? count - done : AT_ONCE);
        prepare(grid, beams, begin + done, some, reach * grid.inverse, rays);
        fly(grid, rays, some, reach, metres + begin + done);
    }
}

extern const CastBeams cast_beams = cast;

}  // namespace SPLATRL_ISA
}  // namespace splatrl
