#include <algorithm>
#include <atomic>
#include <cmath>
#include <vector>

#include <nanobind/stl/array.h>
#include <nanobind/stl/vector.h>

#include "arrays.h"
#include "bindings.h"
#include "collision.h"
#include "first_contact.h"
#include "interpreter.h"
#include "packed_grid.h"
#include "rigid.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

constexpr double FINEST = 1e-4, COARSEST = 1e3, FARTHEST_CORNER = 2e15;  // metres, as in voxel_grid.py
constexpr double TOUCH = 1e-6;   // metres: a gap within the rounding of a pose is a touch, wherever it is in the world
constexpr size_t CHUNK = 2048;   // queries that a thread takes at once
constexpr size_t AT_ONCE = 32;  // queries that are prepared before they are answered

using Solid = Tensor<const bool, -1, -1, -1>;
using Distances = Tensor<const float, -1, -1, -1>;

PackedGrid packed(const Solid& solid, const Distances& distance, const Vec3& corner, double resolution) {
    int size[3];
    for (int i = 0; i < 3; ++i) {
        size[i] = int(solid.shape(i));
        if (solid.shape(i) != distance.shape(i)) throw std::invalid_argument("distance: expected the shape of solid");
    }
    return PackedGrid(solid.data(), distance.data(), size, corner, resolution);
}

Vec3 quotient(const std::array<double, 3>& numbers, double divisor) {
    return {numbers[0] / divisor, numbers[1] / divisor, numbers[2] / divisor};
}

// Prefetch the distance at a point: grids are larger than caches, and poses come in no order.
void fetch(const Grid& grid, const Vec3& point) {
    if (!grid.empty) __builtin_prefetch(&grid.distance[nearest_place(grid, point).voxel]);
}

// Not inlined on purpose: inlined, their answers become branches that cannot be predicted.
__attribute__((noinline)) Verdict judged(const Grid& grid, const Shape& shape, const Vec3& position) {
    return judge(grid, shape, position);
}

__attribute__((noinline)) bool passed(const Grid& grid, const Shape& shape, const Vec3& start, const Vec3& way) {
    return passes(grid, shape, start, way);
}

__attribute__((noinline)) bool rigid(const float* matrix) { return is_pose_by_fours(matrix); }

// A grid and a body in it, whose lengths are in voxels of that grid.
struct Fitted {
    Grid grid;
    Shape shape;
};

// Which grid a query of a batch asks: always the same one,
struct Same {
    const Fitted& fitted;
    bool knows(size_t) const { return true; }
    const Fitted& operator()(size_t) const { return fitted; }
};

// or the one of the query's place.
struct ByPlace {
    const std::vector<const Fitted*>& fitted;
    const int64_t* places;
    bool knows(size_t i) const { return uint64_t(places[i]) < fitted.size(); }
    const Fitted& operator()(size_t i) const { return *fitted[size_t(places[i])]; }
};

// Over a whole batch, call prepare(i, query), which may refuse, for some queries at a time, so that what they need is
// fetched meanwhile, and then answer(first, count, queries). Returns -1, or the first i that was refused.
template <class Query, class Prepare, class Answer>
int64_t each(size_t count, size_t threads, const Prepare& prepare, const Answer& answer) {
    std::atomic<size_t> bad{count};
    const auto run = [&](size_t, size_t chunk) {
        Query queries[AT_ONCE];
        const size_t end = std::min(count, (chunk + 1) * CHUNK);
        for (size_t first = chunk * CHUNK; first < end; first += AT_ONCE) {
            const size_t last = std::min(end, first + AT_ONCE);
            for (size_t i = first; i < last; ++i)
                if (!prepare(i, queries[i - first])) {
                    for (size_t seen = bad; i < seen && !bad.compare_exchange_weak(seen, i);) {
                    }
                    return;
                }
            answer(first, last - first, queries);
        }
    };
    const size_t chunks = (count + CHUNK - 1) / CHUNK;
    if (chunks <= 1) {
        if (chunks == 1) run(0, 0);
    } else {
        const Release release;
        parallel_for(chunks, std::min(threads, chunks), run);
    }
    return bad == count ? -1 : int64_t(bad);
}

// Queries take addresses, which cost less than arrays; Python takes care of types, sizes and lifetimes. `in` says which
// grid each of them asks.
template <class In>
int64_t collides(const In& in, uintptr_t poses, uintptr_t out, size_t count, size_t threads) {
    const auto* matrices = reinterpret_cast<const float*>(poses);
    auto* hits = reinterpret_cast<bool*>(out);
    return each<Vec3>(
        count, threads,
        [&](size_t i, Vec3& position) {
            if (!in.knows(i) || !rigid(matrices + 16 * i)) return false;
            position = position_of(in(i).grid, matrices + 16 * i);
            fetch(in(i).grid, position);
            return true;
        },
        [&](size_t first, size_t some, const Vec3* positions) {
            // First judge all without a branch, then search those that are left: the verdicts cannot be predicted.
            size_t left[AT_ONCE], open = 0;
            for (size_t i = 0; i < some; ++i) {
                const Verdict verdict = judged(in(first + i).grid, in(first + i).shape, positions[i]);
                hits[first + i] = verdict == Verdict::HIT;
                left[open] = i;
                open += verdict == Verdict::MAYBE;
            }
            for (size_t i = 0; i < open; ++i) {
                const size_t row = first + left[i];
                const Grid& grid = in(row).grid;
                hits[row] = touches(in(row).shape, pose_of(grid, matrices + 16 * row), FirstContact{grid});
            }
        });
}

struct Move {
    Vec3 start, way;
};

template <class In, class Answer>
int64_t moves(const In& in, uintptr_t starts, uintptr_t ends, size_t count, size_t threads, bool any,
              const Answer& answer) {
    const auto *from = reinterpret_cast<const float*>(starts), *to = reinterpret_cast<const float*>(ends);
    return each<Move>(
        count, threads,
        [&](size_t i, Move& move) {
            if (!in.knows(i) || !rigid(from + 16 * i) || !rigid(to + 16 * i)) return false;
            const Grid& grid = in(i).grid;
            move.start = position_of(grid, from + 16 * i);
            move.way = between(move.start, position_of(grid, to + 16 * i));
            fetch(grid, along(move.start, move.way, 0.5));
            return true;
        },
        [&](size_t first, size_t some, const Move* moves) {
            size_t left[AT_ONCE], open = 0;
            for (size_t i = 0; i < some; ++i) {
                const Fitted& fitted = in(first + i);
                const bool free = passed(fitted.grid, fitted.shape, moves[i].start, moves[i].way);
                if (free) answer(first + i, 1.0);
                left[open] = i;
                open += !free;
            }
            for (size_t i = 0; i < open; ++i) {
                const size_t row = first + left[i];
                const Grid& grid = in(row).grid;
                answer(row, free_fraction(grid, in(row).shape, pose_of(grid, from + 16 * row),
                                          pose_of(grid, to + 16 * row), any, FirstContact{grid}));
            }
        });
}

template <class In>
int64_t free_fractions(const In& in, uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count, size_t threads) {
    auto* fractions = reinterpret_cast<float*>(out);
    return moves(in, starts, ends, count, threads, false, [&](size_t i, double fraction) {
        fractions[i] = rounded_down(fraction);  // a move that touches stays below 1
    });
}

template <class In>
int64_t sweeps(const In& in, uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count, size_t threads) {
    auto* hits = reinterpret_cast<bool*>(out);
    return moves(in, starts, ends, count, threads, true, [&](size_t i, double fraction) { hits[i] = fraction < 1.0; });
}

template <class In>
int64_t clearance(const In& in, uintptr_t points, uintptr_t out, size_t count, size_t threads) {
    const auto* from = reinterpret_cast<const float*>(points);
    auto* metres = reinterpret_cast<float*>(out);
    return each<Vec3>(
        count, threads,
        [&](size_t i, Vec3& point) {
            const float* place = from + 3 * i;
            if (!in.knows(i)) return false;
            if (!std::isfinite(place[0]) || !std::isfinite(place[1]) || !std::isfinite(place[2])) return false;
            point = place_of(in(i).grid, place[0], place[1], place[2]);
            fetch(in(i).grid, point);
            return true;
        },
        [&](size_t first, size_t some, const Vec3* points) {
            for (size_t i = 0; i < some; ++i)
                metres[first + i] = clearance_in_metres(in(first + i).grid, points[i]);
        });
}

// A body in a grid.
class Collider {
public:
    Collider(PackedGrid packed, const Shape& shape) : packed_(std::move(packed)), fitted_{packed_.view(), shape} {}

    const Fitted& fitted() const { return fitted_; }
    Same in() const { return {fitted_}; }

private:
    PackedGrid packed_;
    Fitted fitted_;
};

// A body in several grids: each query says by number which one it asks. Python keeps the colliders.
class Colliders {
public:
    explicit Colliders(const std::vector<const Collider*>& colliders) {
        for (const Collider* collider : colliders) fitted_.push_back(&collider->fitted());
    }

    ByPlace in(uintptr_t places) const { return {fitted_, reinterpret_cast<const int64_t*>(places)}; }

private:
    std::vector<const Fitted*> fitted_;
};

const Grid& grid_in(nb::handle collider) { return nb::cast<const Collider&>(collider).fitted().grid; }

// An array that a collider keeps, [x, y, along z], without a copy.
template <class T>
nb::ndarray<nb::numpy, const T> array_of(nb::handle collider, const T* Grid::*values, int along_z) {
    const Grid& grid = grid_in(collider);
    return {grid.*values, {size_t(grid.size[0]), size_t(grid.size[1]), size_t(along_z)}, collider};
}

}  // namespace

void bind_collision(nb::module_& m) {
    nb::class_<Collider>(m, "Collider")
        .def(
            "__init__",
            [](Collider* self, Solid solid, Distances distance, std::array<double, 3> corner, double resolution,
               std::array<double, 3> half, double half_length, double radius) {
                // What searches take for granted: places and sizes in voxels stay far below what a double can count.
                bool right = resolution >= FINEST && resolution <= COARSEST;
                for (double length : {corner[0], corner[1], corner[2], half[0], half[1], half[2], half_length, radius})
                    right = right && std::abs(length) <= FARTHEST_CORNER;
                if (!right) throw std::invalid_argument("Collider: expected a resolution and lengths within bounds");
                const auto kind = radius == 0.0 ? Shape::BOX : half_length > 0.0 ? Shape::CAPSULE : Shape::SPHERE;
                const Shape shape =
                    shape_of(kind, quotient(half, resolution), half_length / resolution, radius / resolution);
                new (self) Collider(packed(solid, distance, quotient(corner, 1.0), resolution),
                                    grown(shape, TOUCH / resolution));
            },
            nb::arg("solid"), nb::arg("distance"), nb::arg("corner"), nb::arg("resolution"), nb::arg("half"),
            nb::arg("half_length"), nb::arg("radius"))
        .def_prop_ro("bits", [](nb::handle self) { return array_of(self, &Grid::bits, grid_in(self).words); })
        .def_prop_ro("distance", [](nb::handle self) { return array_of(self, &Grid::distance, grid_in(self).size[2]); })
        .def_prop_ro("shape",
                     [](const Collider& self) {
                         const Shape& shape = self.fitted().shape;
                         const Vec3& half = shape.half;
                         return nb::make_tuple(half[0], half[1], half[2], shape.half_length, shape.radius, shape.inner,
                                               shape.outer);
                     })
        .def("collides", [](const Collider& self, uintptr_t poses, uintptr_t out, size_t count,
                            size_t threads) { return collides(self.in(), poses, out, count, threads); })
        .def("free_fraction",
             [](const Collider& self, uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count, size_t threads) {
                 return free_fractions(self.in(), starts, ends, out, count, threads);
             })
        .def("sweeps",
             [](const Collider& self, uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count, size_t threads) {
                 return sweeps(self.in(), starts, ends, out, count, threads);
             })
        .def("clearance", [](const Collider& self, uintptr_t points, uintptr_t out, size_t count, size_t threads) {
            return clearance(self.in(), points, out, count, threads);
        });
    nb::class_<Colliders>(m, "Colliders")
        .def(nb::init<const std::vector<const Collider*>&>(), nb::arg("colliders"))
        .def("collides", [](const Colliders& self, uintptr_t places, uintptr_t poses, uintptr_t out, size_t count,
                            size_t threads) { return collides(self.in(places), poses, out, count, threads); })
        .def("free_fraction",
             [](const Colliders& self, uintptr_t places, uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count,
                size_t threads) { return free_fractions(self.in(places), starts, ends, out, count, threads); })
        .def("sweeps",
             [](const Colliders& self, uintptr_t places, uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count,
                size_t threads) { return sweeps(self.in(places), starts, ends, out, count, threads); })
        .def("clearance", [](const Colliders& self, uintptr_t places, uintptr_t points, uintptr_t out, size_t count,
                             size_t threads) { return clearance(self.in(places), points, out, count, threads); });
}

}  // namespace splatrl
