// Collision queries of bodies against grids, compiled once for each instruction set. The distance field is read for
// several poses at a time, one per lane; the few poses that it cannot decide are searched one after another. This is
// one file, although a long one, because its parts are templates over lanes and grids that nothing else uses and that
// the compiler has to see together.
#include "query_kernels.h"

#include "collision.h"
#include "doubles.h"
#include "first_contact.h"
#include "quads.h"
#include "rigid.h"

namespace splatrl {
namespace SPLATRL_ISA {

constexpr int AT_ONCE = 32;  // queries that are prepared before any is answered, so that memory is fetched meanwhile
constexpr double WHOLE = 4503599627370496.0;  // 2^52: from here on doubles are integers, held in their lower bits
constexpr double FAR_FROM_TOO_MANY_PARTS = 1000.0;  // voxels: turns of smaller bodies stay below MOST_PARTS_OF_TURN

typedef float Singles __attribute__((vector_size(4 * SPLATRL_DOUBLES)));
typedef int32_t SinglesMask __attribute__((vector_size(4 * SPLATRL_DOUBLES)));

// All queries ask the same grid, the first.
struct Same {
    const Asked& asked;
    const Fitted& operator()(size_t) const { return *asked.fitted[0]; }
    template <class Get>
    Part part(size_t, const Get& get) const {
        return get(*asked.fitted[0]) + Part{};
    }
};

// Each query asks the grid that `places` gives it. Lanes beyond the last query repeat it.
struct ByPlace {
    const Asked& asked;
    size_t last;
    const Fitted& operator()(size_t i) const { return asked(i < last ? i : last); }
    template <class Get>
    Part part(size_t first, const Get& get) const {
        Part out;
        for (int i = 0; i < WIDTH; ++i) out[i] = get((*this)(first + i));
        return out;
    }
};

static inline Part larger(const Part& a, const Part& b) { return a < b ? b : a; }
static inline Part smaller(const Part& a, const Part& b) { return b < a ? b : a; }

// Floor of a, for a in [0, 2^51].
static inline Part floor_of(const Part& a) {
    const Part nearest = (a + WHOLE) - WHOLE;
    return nearest > a ? nearest - 1.0 : nearest;
}

// The upper three rows of a block of poses, stored entry by entry.
struct Rows {
    alignas(64) float at[12][AT_ONCE];

    Singles lanes(int entry, int first) const {
        Singles out;
        std::memcpy(&out, &at[entry][first], sizeof(out));
        return out;
    }
};

// Transpose poses into lanes, four at a time; lanes beyond the last pose repeat it. Returns whether all last rows are
// 0, 0, 0, 1.
static bool spread(const float* poses, int count, Rows& rows) {
    QuadIndex right = {-1, -1, -1, -1};
    for (int first = 0; first < count || first % WIDTH != 0; first += 4) {
        const float* of[4];
        for (int i = 0; i < 4; ++i) of[i] = poses + 16 * (first + i < count ? first + i : count - 1);
        for (int row = 0; row < 3; ++row) {
            Quad quads[4];
            for (int i = 0; i < 4; ++i) std::memcpy(&quads[i], of[i] + 4 * row, sizeof(Quad));
            turn_quads(quads);
            for (int i = 0; i < 4; ++i) std::memcpy(&rows.at[4 * row + i][first], &quads[i], sizeof(Quad));
        }
        for (int i = 0; i < 4; ++i) {
            Quad last;
            std::memcpy(&last, of[i] + 12, sizeof(last));
            last -= Quad{0.0f, 0.0f, 0.0f, 1.0f};
            right &= (last <= ORTHONORMAL) & (last >= -ORTHONORMAL);
        }
    }
    return (right[0] & right[1] & right[2] & right[3]) != 0;
}

// Whether all poses are rigid, by the arithmetic of `is_pose_by_fours`, so that the two agree on every pose.
static bool all_rigid(const Rows& rows, int count) {
    SinglesMask right = SinglesMask{} == SinglesMask{};
    const auto small = [](const Singles& a) { return (a <= ORTHONORMAL) & (a >= -ORTHONORMAL); };
    for (int first = 0; first < count; first += WIDTH) {
        Singles x[3], y[3], z[3], volume[3];
        for (int i = 0; i < 3; ++i) {
            x[i] = rows.lanes(i, first);
            y[i] = rows.lanes(4 + i, first);
            z[i] = rows.lanes(8 + i, first);
        }
        for (int i = 0; i < 3; ++i) {
            const int next = (i + 1) % 3, after = (i + 2) % 3;
            right &= small(x[i] * x[i] + y[i] * y[i] + z[i] * z[i] - 1.0f);
            right &= small(x[i] * x[next] + y[i] * y[next] + z[i] * z[next]);
            volume[i] = z[i] * (x[next] * y[after] - x[after] * y[next]);
        }
        right &= volume[0] + volume[1] + volume[2] > 0.0f;
        // NaN where the position is not finite
        right &= small(0.0f * rows.lanes(3, first) + 0.0f * rows.lanes(7, first) + 0.0f * rows.lanes(11, first));
    }
    bool all = true;
    for (int i = 0; i < WIDTH; ++i) all = all && right[i] != 0;
    return all;
}

// Positions of a block of queries, in voxels.
struct Points {
    alignas(64) double at[3][AT_ONCE];
};

template <class In>
static void positions(const In& in, size_t begin, int count, const Rows& rows, Points& out) {
    for (int first = 0; first < count; first += WIDTH) {
        const Part inverse = in.part(begin + first, [](const Fitted& one) { return one.grid.inverse; });
        for (int axis = 0; axis < 3; ++axis) {
            const Part corner = in.part(begin + first, [&](const Fitted& one) { return one.grid.corner[axis]; });
            const Part metres = __builtin_convertvector(rows.lanes(4 * axis + 3, first), Part);
            store(out.at[axis] + first, (metres - corner) * inverse);
        }
    }
}

// Where one register of points lies in their grids, as `nearby` needs it.
struct Place {
    Part outside, to_center;  // squared distances to the grid and to the centre of the voxel
    Mask voxel;
};

// Where a block of points lies in their grids: the members of Place, for each point.
struct Places {
    alignas(64) double outside[AT_ONCE], to_center[AT_ONCE];
    alignas(64) int64_t voxel[AT_ONCE];
};

static inline Place place_in(const Part (&point)[3], const Part (&size)[3]) {
    Place out{};
    Part index[3];
    for (int axis = 0; axis < 3; ++axis) {
        const Part within = smaller(larger(point[axis], Part{}), size[axis]);
        index[axis] = smaller(floor_of(within), size[axis] - 1.0);
        const Part beyond = point[axis] - within, off = within - index[axis] - 0.5;
        out.outside += beyond * beyond;
        out.to_center += off * off;
    }
    constexpr int64_t LOW = (int64_t(1) << 52) - 1;
    const Part voxel = (index[0] * size[1] + index[1]) * size[2] + index[2];
    out.voxel = (Mask)(voxel + WHOLE) & LOW;
    return out;
}

template <class In>
static inline void sizes_of(const In& in, size_t first, Part (&size)[3]) {
    for (int axis = 0; axis < 3; ++axis)
        size[axis] = in.part(first, [&](const Fitted& one) { return double(one.grid.size[axis]); });
}

template <class In>
static void find(const In& in, size_t begin, int count, const Points& points, Places& out) {
    for (int first = 0; first < count; first += WIDTH) {
        Part size[3];
        sizes_of(in, begin + first, size);
        const Part point[3] = {load(points.at[0] + first), load(points.at[1] + first), load(points.at[2] + first)};
        const Place place = place_in(point, size);
        store(out.outside + first, place.outside);
        store(out.to_center + first, place.to_center);
        std::memcpy(&out.voxel[first], &place.voxel, sizeof(place.voxel));
    }
    for (int i = 0; i < count; ++i) {
        const Grid& grid = in(begin + i).grid;
        if (!grid.empty) __builtin_prefetch(&grid.distance[out.voxel[i]]);
    }
}

// Bounds on the distance to anything solid, as in `nearby`; both are 0 for a point within a solid voxel.
struct Near {
    Part at_least, at_most;
};

static inline Near near_of(const Part& outside, const Part& to_center_squared, const Part& steps) {
    const Part to_center = root(to_center_squared);
    const Part inside = larger(steps / DISTANCE_STEPS - HALF_DIAGONAL - to_center, Part{});
    const Mask is_within = outside == 0.0;
    Near out;
    out.at_least = is_within ? inside : root(outside + inside * inside);
    const Mask is_near = is_within & (steps < double(FARTHEST));
    out.at_most = is_near ? (steps + 1.0) / DISTANCE_STEPS + to_center : NEVER + Part{};
    out.at_most = (is_within & (steps == 0.0)) ? Part{} : out.at_most;
    return out;
}

template <class In>
static inline Near nears(const In& in, size_t begin, int first, const Places& places) {
    Part steps;
    for (int i = 0; i < WIDTH; ++i) {
        const Grid& grid = in(begin + first + i).grid;
        steps[i] = grid.empty ? INFINITE : double(grid.distance[places.voxel[first + i]]);
    }
    return near_of(load(places.outside + first), load(places.to_center + first), steps);
}

// Mask of the balls that certainly touch something.
static inline Mask surely(const Near& near, const Part& radius) {
    return (near.at_most <= radius - MARGIN) | (near.at_most == 0.0);
}

// Indices of the queries of a block that are still undecided.
struct Left {
    int at[AT_ONCE + WIDTH];
    int count = 0;

    // Branch-free, because which queries are left cannot be predicted.
    void add(int i, bool is_left) {
        at[count] = i;
        count += is_left;
    }
};

constexpr int PARTS = 2 * Balls::COUNT > WIDTH ? 2 * Balls::COUNT / WIDTH : 1;  // registers for a body's balls

// The centres of one register of a body's balls, at a pose.
static inline void centers(const Balls& balls, const Pose& pose, int part, Part (&out)[3]) {
    for (int axis = 0; axis < 3; ++axis) {
        out[axis] = pose.position[axis] + Part{};
        for (int k = 0; k < 3; ++k) out[axis] += pose.rotation[axis][k] * load(balls.at[k] + WIDTH * part);
    }
}

// Mask of the lanes that hold balls within a body, rather than balls that cover it.
static inline Mask kinds(int part) {
    Mask out;
    for (int i = 0; i < WIDTH; ++i) out[i] = -int64_t(WIDTH * part + i < Balls::COUNT);
    return out;
}

// A lookup for the balls of a moving body: where the balls within it are at the start and the balls that cover it
// halfway, and the least distance to anything solid at which the latter stay free for the whole move.
struct Asking {
    Place place;
    Part least;
};

// Prepare the lookup for a move. While a body moves and turns by at most half a turn, the centre of each of its balls
// stays within a ball whose diameter is how far the translation and the turn move it. The exact search grows a turning
// body by a slack; the least distance includes this, so that the search would not find anything either.
static inline Asking asking_on_way(const Fitted& fitted, const Pose& start, const Pose& end, int part) {
    Part from[3], to[3], size[3], turned{};
    const Vec3 way = between(start.position, end.position);
    centers(fitted.balls, start, part, from);
    centers(fitted.balls, end, part, to);
    const Mask is_within = kinds(part);
    for (int axis = 0; axis < 3; ++axis) {
        const Part by = to[axis] - from[axis] - way[axis];
        turned += by * by;
        size[axis] = double(fitted.grid.size[axis]) + Part{};
        from[axis] = is_within ? from[axis] : 0.5 * (from[axis] + to[axis]);
    }
    const double turning = same(start.rotation, end.rotation) ? 0.0 : 2.0 * TURN_SLACK;  // √3 times the slack, and more
    return {place_in(from, size), fitted.balls.around + 0.5 * norm(way) + 0.5 * root(turned) + turning + MARGIN};
}

// Decide those moves for which the balls suffice: calls hit(query) or free(query), and adds all others to `rest`. A
// move may end where it starts.
template <class In, class Hit, class Free>
static void try_balls(const In& in, size_t begin, const float* starts, const float* ends, const Left& open, Left& rest,
                      const Hit& hit, const Free& free) {
    if (open.count == 0 || !in(begin).balls.some) {  // `some` is the same for all grids
        rest = open;
        return;
    }
    Asking asked[AT_ONCE][PARTS];
    for (int i = 0; i < open.count; ++i) {
        const size_t row = begin + open.at[i];
        const Grid& grid = in(row).grid;
        const Pose start = pose_of(grid, starts + 16 * row), end = pose_of(grid, ends + 16 * row);
        for (int part = 0; part < PARTS; ++part) {
            asked[i][part] = asking_on_way(in(row), start, end, part);
            for (int lane = 0; lane < WIDTH; ++lane)
                __builtin_prefetch(&grid.distance[asked[i][part].place.voxel[lane]]);
        }
    }
    for (int i = 0; i < open.count; ++i) {
        const Fitted& fitted = in(begin + open.at[i]);
        bool hits = false, frees = fitted.shape.outer < FAR_FROM_TOO_MANY_PARTS;
        for (int part = 0; part < PARTS; ++part) {
            const Asking& one = asked[i][part];
            Part steps;
            for (int lane = 0; lane < WIDTH; ++lane) steps[lane] = fitted.grid.distance[one.place.voxel[lane]];
            const Near near = near_of(one.place.outside, one.place.to_center, steps);
            const Mask touched = kinds(part) & surely(near, fitted.balls.within + Part{});
            const Mask away = kinds(part) | (near.at_least > one.least);
            for (int lane = 0; lane < WIDTH; ++lane) {
                hits |= touched[lane] != 0;
                frees &= away[lane] != 0;
            }
        }
        const int query = open.at[i];
        if (hits)
            hit(begin + query);
        else if (frees)
            free(begin + query);
        rest.add(query, !hits && !frees);
    }
}

// Compute the positions of a block of poses; false if one of the queries may have to be refused.
template <class In>
static bool ready(const In& in, size_t begin, int count, const float* poses, Points& points) {
    for (int i = 0; i < count; ++i)
        if (!in.asked.knows(begin + i)) return false;
    Rows rows;
    const bool right = spread(poses + 16 * begin, count, rows);
    positions(in, begin, count, rows, points);
    return right && all_rigid(rows, count);
}

// The first query of a block that cannot be answered, or `end` if there is none.
template <class In>
static size_t refused(const In& in, size_t begin, size_t end, const float* poses, const float* others) {
    for (size_t i = begin; i < end; ++i)
        if (!in.asked.knows(i) || !is_pose_by_fours(poses + 16 * i) || !is_pose_by_fours(others + 16 * i)) return i;
    return end;
}

template <class In>
static size_t collide(const In& in, const float* poses, bool* hits, size_t from, size_t end) {
    for (size_t begin = from; begin < end; begin += AT_ONCE) {
        const int count = int(end - begin < AT_ONCE ? end - begin : AT_ONCE);
        Points points;
        if (!ready(in, begin, count, poses, points)) {
            const size_t bad = refused(in, begin, begin + count, poses, poses);
            if (bad < begin + count) return bad;
        }
        Places places;
        find(in, begin, count, points, places);
        Left open, rest;
        for (int first = 0; first < count; first += WIDTH) {
            const Near near = nears(in, begin, first, places);
            const Part outer = in.part(begin + first, [](const Fitted& one) { return one.shape.outer; });
            const Part inner = in.part(begin + first, [](const Fitted& one) { return one.shape.inner; });
            const Mask hit = surely(near, inner), maybe = ~hit & ~(near.at_least > outer + MARGIN);
            for (int i = 0; i < WIDTH && first + i < count; ++i) {
                hits[begin + first + i] = hit[i] != 0;
                open.add(first + i, maybe[i] != 0);
            }
        }
        try_balls(in, begin, poses, poses, open, rest, [&](size_t row) { hits[row] = true; }, [](size_t) {});
        for (int i = 0; i < rest.count; ++i) {
            const size_t row = begin + rest.at[i];
            const Grid& grid = in(row).grid;
            hits[row] = touches(in(row).shape, pose_of(grid, poses + 16 * row), FirstContact{grid});
        }
    }
    return end;
}

// Sweep moves, and call answer(i, fraction) for each; a second call for the same i replaces the first. With `any`, a
// fraction below 1 says only that something is hit.
template <bool any, class In, class Answer>
static size_t move(const In& in, const float* starts, const float* ends, size_t first_row, size_t end,
                   const Answer& answer) {
    for (size_t begin = first_row; begin < end; begin += AT_ONCE) {
        const int count = int(end - begin < AT_ONCE ? end - begin : AT_ONCE);
        Points from, to, middle;
        const bool right = ready(in, begin, count, starts, from);
        if (!ready(in, begin, count, ends, to) || !right) {
            const size_t bad = refused(in, begin, begin + count, starts, ends);
            if (bad < begin + count) return bad;
        }
        alignas(64) double way[AT_ONCE];
        for (int first = 0; first < count; first += WIDTH) {
            Part squares{};
            for (int axis = 0; axis < 3; ++axis) {
                const Part start = load(from.at[axis] + first), along = load(to.at[axis] + first) - start;
                squares += along * along;
                store(middle.at[axis] + first, start + 0.5 * along);
            }
            store(way + first, root(squares));
        }
        Places here, there, halfway;
        find(in, begin, count, middle, halfway);
        find(in, begin, count, from, here);
        if (any) find(in, begin, count, to, there);
        Left open, rest;
        for (int first = 0; first < count; first += WIDTH) {
            const Near near = nears(in, begin, first, halfway);
            const Part outer = in.part(begin + first, [](const Fitted& one) { return one.shape.outer; });
            const Part inner = in.part(begin + first, [](const Fitted& one) { return one.shape.inner; });
            const Mask free = near.at_least > outer + 0.5 * load(way + first) + MARGIN;
            Mask hit = surely(nears(in, begin, first, here), inner);
            if (any) hit |= surely(near, inner) | surely(nears(in, begin, first, there), inner);
            for (int i = 0; i < WIDTH && first + i < count; ++i) {
                answer(begin + first + i, hit[i] ? 0.0 : 1.0);
                open.add(first + i, !hit[i] && !free[i]);
            }
        }
        const auto touched = [&](size_t row) { answer(row, 0.0); };
        try_balls(in, begin, starts, ends, open, rest, touched, [](size_t) {});
        for (int i = 0; i < rest.count; ++i) {
            const size_t row = begin + rest.at[i];
            const Grid& grid = in(row).grid;
            answer(row, free_fraction(grid, in(row).shape, pose_of(grid, starts + 16 * row),
                                      pose_of(grid, ends + 16 * row), any, FirstContact{grid}));
        }
    }
    return end;
}

// Call work(in), where `in` gives the grid that each query asks.
template <class Work>
static size_t asking(const Asked& asked, size_t end, const Work& work) {
    return asked.places == nullptr ? work(Same{asked}) : work(ByPlace{asked, end - 1});
}

static size_t collides(const Asked& asked, const float* poses, bool* hits, size_t begin, size_t end) {
    return asking(asked, end, [&](const auto& in) { return collide(in, poses, hits, begin, end); });
}

static size_t sweeps(const Asked& asked, const float* starts, const float* ends, bool* hits, size_t begin, size_t end) {
    const auto answer = [&](size_t i, double fraction) { hits[i] = fraction < 1.0; };
    return asking(asked, end, [&](const auto& in) { return move<true>(in, starts, ends, begin, end, answer); });
}

static size_t free_fractions(const Asked& asked, const float* starts, const float* ends, float* shares, size_t begin,
                             size_t end) {
    // rounded down, so that the fraction of a move that touches something stays below 1
    const auto answer = [&](size_t i, double fraction) { shares[i] = rounded_down(fraction); };
    return asking(asked, end, [&](const auto& in) { return move<false>(in, starts, ends, begin, end, answer); });
}

extern const QueryKernels query_kernels = {collides, sweeps, free_fractions};

}  // namespace SPLATRL_ISA
}  // namespace splatrl
