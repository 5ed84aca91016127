#include <algorithm>
#include <atomic>
#include <cmath>
#include <vector>

#include <nanobind/stl/array.h>
#include <nanobind/stl/vector.h>

#include "arrays.h"
#include "bindings.h"
#include "interpreter.h"
#include "packed_grid.h"
#include "query_kernels.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

const QueryKernels& query_kernels_of(Isa isa) {
    switch (isa) {
#ifdef SPLATRL_X86
        case Isa::avx512: return avx512::query_kernels;
        case Isa::avx2: return avx2::query_kernels;
#endif
        default: return portable::query_kernels;
    }
}

namespace {

constexpr double FINEST = 1e-4, COARSEST = 1e3, FARTHEST_CORNER = 2e15;  // metres, as in voxel_grid.py
constexpr double TOUCH = 1e-6;   // metres: a gap within the rounding error of a pose is a touch, anywhere in the world
constexpr size_t CHUNK = 2048;   // queries per work item of a thread
constexpr size_t AT_ONCE = 32;   // points whose voxels are prefetched before any of them is read

using Solid = Tensor<const bool, -1, -1, -1>;
using Distances = Tensor<const float, -1, -1, -1>;

PackedGrid packed(const Solid& solid, const Distances& distance, const Vec3& corner, double resolution) {
    int size[3];
    for (int i = 0; i < 3; ++i) {
        size[i] = int(solid.shape(i));
        if (solid.shape(i) != distance.shape(i))
            throw std::invalid_argument("distance: expected the same shape as solid");
    }
    return PackedGrid(solid.data(), distance.data(), size, corner, resolution);
}

Vec3 quotient(const std::array<double, 3>& numbers, double divisor) {
    return {numbers[0] / divisor, numbers[1] / divisor, numbers[2] / divisor};
}

// Call answer(begin, end) for chunks of a batch, in parallel; it returns the first query that it rejects, or `end`.
// Returns the first query of the batch that was rejected, or -1.
template <class Answer>
int64_t each(size_t count, size_t threads, const Answer& answer) {
    std::atomic<size_t> bad{count};
    const auto run = [&](size_t, size_t chunk) {
        const size_t end = std::min(count, (chunk + 1) * CHUNK), first = answer(chunk * CHUNK, end);
        if (first == end) return;
        for (size_t seen = bad; first < seen && !bad.compare_exchange_weak(seen, first);) {
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

// Queries of one body against one grid, or several. They take raw addresses, which are cheaper to pass than arrays;
// Python takes care of types, sizes and lifetimes.
struct Queries {
    const QueryKernels& kernels;
    Asked asked;

    int64_t collides(uintptr_t poses, uintptr_t out, size_t count, size_t threads) const {
        const auto* matrices = reinterpret_cast<const float*>(poses);
        auto* hits = reinterpret_cast<bool*>(out);
        return each(count, threads,
                    [&](size_t begin, size_t end) { return kernels.collides(asked, matrices, hits, begin, end); });
    }

    int64_t free_fraction(uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count, size_t threads) const {
        const auto *from = reinterpret_cast<const float*>(starts), *to = reinterpret_cast<const float*>(ends);
        auto* shares = reinterpret_cast<float*>(out);
        return each(count, threads, [&](size_t begin, size_t end) {
            return kernels.free_fraction(asked, from, to, shares, begin, end);
        });
    }

    int64_t sweeps(uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count, size_t threads) const {
        const auto *from = reinterpret_cast<const float*>(starts), *to = reinterpret_cast<const float*>(ends);
        auto* hits = reinterpret_cast<bool*>(out);
        return each(count, threads,
                    [&](size_t begin, size_t end) { return kernels.sweeps(asked, from, to, hits, begin, end); });
    }

    int64_t clearance(uintptr_t points, uintptr_t out, size_t count, size_t threads) const {
        const auto* from = reinterpret_cast<const float*>(points);
        auto* metres = reinterpret_cast<float*>(out);
        return each(count, threads, [&](size_t begin, size_t end) {
            Vec3 places[AT_ONCE];
            for (size_t first = begin; first < end; first += AT_ONCE) {
                const size_t last = std::min(end, first + AT_ONCE);
                for (size_t i = first; i < last; ++i) {
                    const float* at = from + 3 * i;
                    const bool finite = std::isfinite(at[0]) && std::isfinite(at[1]) && std::isfinite(at[2]);
                    if (!asked.knows(i) || !finite) return i;
                    const Grid& grid = asked(i).grid;
                    const Vec3 place = places[i - first] = place_of(grid, at[0], at[1], at[2]);
                    if (!grid.empty) __builtin_prefetch(&grid.distance[nearest_place(grid, place).voxel]);
                }
                for (size_t i = first; i < last; ++i) metres[i] = clearance_in_metres(asked(i).grid, places[i - first]);
            }
            return end;
        });
    }
};

// A body and the grid that it is tested against.
class Collider {
public:
    Collider(PackedGrid packed, const Shape& shape)
        : packed_(std::move(packed)), fitted_{packed_.view(), shape, balls_in(shape)},
          kernels_(query_kernels_of(choose_isa())) {}
    Collider(const Collider&) = delete;  // `here_` points into it

    const Fitted& fitted() const { return fitted_; }
    Queries queries() const { return {kernels_, {&here_, 1, nullptr}}; }

private:
    PackedGrid packed_;
    Fitted fitted_;
    const Fitted* here_ = &fitted_;
    const QueryKernels& kernels_;
};

// A body and several grids; each query selects its grid by index. Python keeps the colliders alive.
class Colliders {
public:
    explicit Colliders(const std::vector<const Collider*>& colliders) : kernels_(query_kernels_of(choose_isa())) {
        for (const Collider* collider : colliders) fitted_.push_back(&collider->fitted());
    }

    Queries queries(uintptr_t places) const {
        return {kernels_, {fitted_.data(), fitted_.size(), reinterpret_cast<const int64_t*>(places)}};
    }

private:
    std::vector<const Fitted*> fitted_;
    const QueryKernels& kernels_;
};

const Grid& grid_in(nb::handle collider) { return nb::cast<const Collider&>(collider).fitted().grid; }

// View an array that a collider owns, [x, y, along_z], without a copy.
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
                // The searches rely on bounded lengths: in voxels, positions and sizes must stay exact as doubles.
                bool right = resolution >= FINEST && resolution <= COARSEST;
                for (double length : {corner[0], corner[1], corner[2], half[0], half[1], half[2], half_length, radius})
                    right = right && std::abs(length) <= FARTHEST_CORNER;
                if (!right) throw std::invalid_argument("Collider: resolution or lengths out of bounds");
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
                            size_t threads) { return self.queries().collides(poses, out, count, threads); })
        .def("free_fraction",
             [](const Collider& self, uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count, size_t threads) {
                 return self.queries().free_fraction(starts, ends, out, count, threads);
             })
        .def("sweeps",
             [](const Collider& self, uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count, size_t threads) {
                 return self.queries().sweeps(starts, ends, out, count, threads);
             })
        .def("clearance", [](const Collider& self, uintptr_t points, uintptr_t out, size_t count, size_t threads) {
            return self.queries().clearance(points, out, count, threads);
        });
    nb::class_<Colliders>(m, "Colliders")
        .def(nb::init<const std::vector<const Collider*>&>(), nb::arg("colliders"))
        .def("collides", [](const Colliders& self, uintptr_t places, uintptr_t poses, uintptr_t out, size_t count,
                            size_t threads) { return self.queries(places).collides(poses, out, count, threads); })
        .def("free_fraction",
             [](const Colliders& self, uintptr_t places, uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count,
                size_t threads) { return self.queries(places).free_fraction(starts, ends, out, count, threads); })
        .def("sweeps",
             [](const Colliders& self, uintptr_t places, uintptr_t starts, uintptr_t ends, uintptr_t out, size_t count,
                size_t threads) { return self.queries(places).sweeps(starts, ends, out, count, threads); })
        .def("clearance", [](const Colliders& self, uintptr_t places, uintptr_t points, uintptr_t out, size_t count,
                             size_t threads) { return self.queries(places).clearance(points, out, count, threads); });
}

}  // namespace splatrl
