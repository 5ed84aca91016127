#include <algorithm>
#include <atomic>
#include <cmath>

#include <nanobind/stl/array.h>

#include "arrays.h"
#include "bindings.h"
#include "collision.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

constexpr double TOUCH = 1e-6;   // metres: what touches to the rounding of a pose touches, wherever it is in the world
constexpr size_t CHUNK = 2048;   // queries that a thread takes at once
constexpr size_t AT_ONCE = 32;  // queries that are prepared before they are answered

using Solid = Tensor<const bool, -1, -1, -1>;
using Distances = Tensor<const float, -1, -1, -1>;

Grid grid_of(const Solid& solid, const Distances& distance, const Vec3& corner, double resolution) {
    Grid grid{};
    for (int i = 0; i < 3; ++i) {
        grid.size[i] = int(solid.shape(i));
        if (solid.shape(i) != distance.shape(i)) throw std::invalid_argument("distance: expected the shape of solid");
    }
    grid.resolution = resolution;
    grid.inverse = 1.0 / resolution;
    grid.corner = corner;
    grid.words = (grid.size[2] + 63) / 64;
    const size_t columns = solid.shape(0) * solid.shape(1), height = solid.shape(2);
    grid.bits.assign(columns * grid.words, 0);
    for (size_t column = 0; column < columns; ++column)
        for (size_t z = 0; z < height; ++z) {
            const bool filled = solid.data()[column * height + z];
            grid.bits[column * grid.words + z / 64] |= uint64_t(filled) << z % 64;
            grid.solid += filled;
        }
    grid.distance = make_buffer<uint16_t>(columns * height);
    for (size_t i = 0; i < columns * height; ++i) {
        const double steps = distance.data()[i] / resolution * (1.0 - 1e-6) * DISTANCE_STEPS;  // single precision
        grid.distance[i] = uint16_t(std::min(steps, double(FARTHEST)));
    }
    return grid;
}

// A body in a grid. Queries take addresses, which cost less than arrays; Python sees to types, sizes and lifetimes.
class Collider {
public:
    Collider(Grid grid, Shape shape) : grid_(std::move(grid)), shape_(shape) {}

    // Call prepare(i, query), which may refuse, for some queries at a time, so that what they need is fetched meanwhile,
    // and then answer(first, count, queries), for all of a batch. Returns -1, or the first i that was refused.
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
            const nb::gil_scoped_release release;
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
                position = position_of(matrices + 16 * i, grid_);
                if (!is_pose(matrices + 16 * i)) return false;
                fetch(grid_, position);
                return true;
            },
            [&](size_t first, size_t some, const Vec3* positions) {
                // Judged without a branch, then those that are left: what comes next cannot be foretold.
                size_t left[AT_ONCE], open = 0;
                for (size_t i = 0; i < some; ++i) {
                    const Verdict verdict = judge(grid_, shape_, positions[i]);
                    hits[first + i] = verdict == Verdict::HIT;
                    left[open] = i;
                    open += verdict == Verdict::MAYBE;
                }
                for (size_t i = 0; i < open; ++i) {
                    const size_t row = first + left[i];
                    hits[row] = touches(grid_, shape_, pose_of(matrices + 16 * row, grid_));
                }
            });
    }

    struct Move {
        Vec3 start, end;
    };

    template <class Answer>
    int64_t moves(uintptr_t starts, uintptr_t ends, size_t count, size_t threads, bool any, const Answer& answer) const {
        const auto *from = reinterpret_cast<const float*>(starts), *to = reinterpret_cast<const float*>(ends);
        return each<Move>(
            count, threads,
            [&](size_t i, Move& move) {
                if (!is_pose(from + 16 * i) || !is_pose(to + 16 * i)) return false;
                move = {position_of(from + 16 * i, grid_), position_of(to + 16 * i, grid_)};
                Vec3 middle;
                for (int k = 0; k < 3; ++k) middle[k] = 0.5 * (move.start[k] + move.end[k]);
                fetch(grid_, middle);
                return true;
            },
            [&](size_t first, size_t some, const Move* moves) {
                size_t left[AT_ONCE], open = 0;
                for (size_t i = 0; i < some; ++i) {
                    const bool free = passes(grid_, shape_, moves[i].start, moves[i].end);
                    if (free) answer(first + i, 1.0);
                    left[open] = i;
                    open += !free;
                }
                for (size_t i = 0; i < open; ++i) {
                    const size_t row = first + left[i];
                    answer(row, splatrl::touched_fraction(grid_, shape_, pose_of(from + 16 * row, grid_),
                                                          pose_of(to + 16 * row, grid_), any));
                }
            });
    }

    int64_t touched_fraction(uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count, size_t threads) const {
        auto* fractions = reinterpret_cast<float*>(out);
        return moves(starts, ends, count, threads, false, [&](size_t i, double fraction) {
            // rounded down, so that what is touched stays below 1
            float rounded = float(fraction);
            if (double(rounded) > fraction) rounded = std::nextafter(rounded, 0.0f);
            fractions[i] = rounded;
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
                for (int axis = 0; axis < 3; ++axis) {
                    if (!std::isfinite(from[3 * i + axis])) return false;
                    point[axis] = (from[3 * i + axis] - grid_.corner[axis]) * grid_.inverse;
                }
                fetch(grid_, point);
                return true;
            },
            [&](size_t first, size_t some, const Vec3* points) {
                for (size_t i = 0; i < some; ++i)
                    metres[first + i] = float(splatrl::clearance(grid_, points[i]) * grid_.resolution * (1.0 - 1e-6));
            });
    }

private:
    Grid grid_;
    Shape shape_;
};

}  // namespace

void bind_collision(nb::module_& m) {
    nb::class_<Collider>(m, "Collider")
        .def(
            "__init__",
            [](Collider* self, Solid solid, Distances distance, Vec3 corner, double resolution, Vec3 half,
               double half_length, double radius) {
                const auto kind = radius == 0.0 ? Shape::BOX : half_length > 0.0 ? Shape::CAPSULE : Shape::SPHERE;
                for (double& extent : half) extent /= resolution;
                const Shape shape(kind, half, half_length / resolution, radius / resolution);
                new (self) Collider(grid_of(solid, distance, corner, resolution), shape.grown(TOUCH / resolution));
            },
            nb::arg("solid"), nb::arg("distance"), nb::arg("corner"), nb::arg("resolution"), nb::arg("half"),
            nb::arg("half_length"), nb::arg("radius"))
        .def("collides", &Collider::collides)
        .def("touched_fraction", &Collider::touched_fraction)
        .def("sweeps", &Collider::sweeps)
        .def("clearance", &Collider::clearance);
}

}  // namespace splatrl
