#include <algorithm>
#include <atomic>
#include <cmath>

#include <nanobind/stl/array.h>

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

// A body in a grid. Queries take addresses, which cost less than arrays; Python takes care of types, sizes and
// lifetimes.
class Collider {
public:
    Collider(PackedGrid packed, const Shape& shape)
        : packed_(std::move(packed)), grid_(packed_.view()), shape_(shape) {}

    // Over a whole batch, call prepare(i, query), which may refuse, for some queries at a time, so that what they need
    // is fetched meanwhile, and then answer(first, count, queries). Returns -1, or the first i that was refused.
    template <class Query, class Prepare, class Answer>
    int64_t each(size_t count, size_t threads, const Prepare& prepare, const Answer& answer) const {
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

    int64_t collides(uintptr_t poses, uintptr_t out, size_t count, size_t threads) const {
        const auto* matrices = reinterpret_cast<const float*>(poses);
        auto* hits = reinterpret_cast<bool*>(out);
        return each<Vec3>(
            count, threads,
            [&](size_t i, Vec3& position) {
                position = position_of(grid_, matrices + 16 * i);
                if (!rigid(matrices + 16 * i)) return false;
                fetch(grid_, position);
                return true;
            },
            [&](size_t first, size_t some, const Vec3* positions) {
                // First judge all without a branch, then search those that are left: the verdicts cannot be predicted.
                size_t left[AT_ONCE], open = 0;
                for (size_t i = 0; i < some; ++i) {
                    const Verdict verdict = judged(grid_, shape_, positions[i]);
                    hits[first + i] = verdict == Verdict::HIT;
                    left[open] = i;
                    open += verdict == Verdict::MAYBE;
                }
                for (size_t i = 0; i < open; ++i) {
                    const size_t row = first + left[i];
                    hits[row] = touches(shape_, pose_of(grid_, matrices + 16 * row), FirstContact{grid_});
                }
            });
    }

    struct Move {
        Vec3 start, way;
    };

    template <class Answer>
    int64_t moves(uintptr_t starts, uintptr_t ends, size_t count, size_t threads, bool any, const Answer& answer) const {
        const auto *from = reinterpret_cast<const float*>(starts), *to = reinterpret_cast<const float*>(ends);
        return each<Move>(
            count, threads,
            [&](size_t i, Move& move) {
                if (!rigid(from + 16 * i) || !rigid(to + 16 * i)) return false;
                move.start = position_of(grid_, from + 16 * i);
                move.way = between(move.start, position_of(grid_, to + 16 * i));
                fetch(grid_, along(move.start, move.way, 0.5));
                return true;
            },
            [&](size_t first, size_t some, const Move* moves) {
                size_t left[AT_ONCE], open = 0;
                for (size_t i = 0; i < some; ++i) {
                    const bool free = passed(grid_, shape_, moves[i].start, moves[i].way);
                    if (free) answer(first + i, 1.0);
                    left[open] = i;
                    open += !free;
                }
                for (size_t i = 0; i < open; ++i) {
                    const size_t row = first + left[i];
                    answer(row, splatrl::free_fraction(grid_, shape_, pose_of(grid_, from + 16 * row),
                                                          pose_of(grid_, to + 16 * row), any, FirstContact{grid_}));
                }
            });
    }

    int64_t free_fraction(uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count, size_t threads) const {
        auto* fractions = reinterpret_cast<float*>(out);
        return moves(starts, ends, count, threads, false, [&](size_t i, double fraction) {
            fractions[i] = rounded_down(fraction);  // a move that touches stays below 1
        });
    }

    int64_t sweeps(uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count, size_t threads) const {
        auto* hits = reinterpret_cast<bool*>(out);
        return moves(starts, ends, count, threads, true, [&](size_t i, double fraction) { hits[i] = fraction < 1.0; });
    }

    int64_t clearance(uintptr_t points, uintptr_t out, size_t count, size_t threads) const {
        const auto* from = reinterpret_cast<const float*>(points);
        auto* metres = reinterpret_cast<float*>(out);
        return each<Vec3>(
            count, threads,
            [&](size_t i, Vec3& point) {
                const float* place = from + 3 * i;
                if (!std::isfinite(place[0]) || !std::isfinite(place[1]) || !std::isfinite(place[2])) return false;
                point = place_of(grid_, place[0], place[1], place[2]);
                fetch(grid_, point);
                return true;
            },
            [&](size_t first, size_t some, const Vec3* points) {
                for (size_t i = 0; i < some; ++i)
                    metres[first + i] = clearance_in_metres(grid_, points[i]);
            });
    }

    const Grid& grid() const { return grid_; }
    const Shape& shape() const { return shape_; }

private:
    PackedGrid packed_;
    Grid grid_;
    Shape shape_;
};

const Grid& grid_in(nb::handle collider) { return nb::cast<const Collider&>(collider).grid(); }

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
                         const Shape& shape = self.shape();
                         const Vec3& half = shape.half;
                         return nb::make_tuple(half[0], half[1], half[2], shape.half_length, shape.radius, shape.inner,
                                               shape.outer);
                     })
        .def("collides", &Collider::collides)
        .def("free_fraction", &Collider::free_fraction)
        .def("sweeps", &Collider::sweeps)
        .def("clearance", &Collider::clearance);
}

}  // namespace splatrl
