// Distance from every voxel of a grid to the nearest solid one: the exact Euclidean distance transform, one axis at a
// time (Meijster, Roerdink & Hesselink, "A general algorithm for computing distance transforms in linear time", 2000).

#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "bindings.h"
#include "interpreter.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

constexpr int64_t NOTHING = int64_t(1) << 40;  // stands for infinity, in squared voxels; its sums do not overflow
constexpr size_t ABREAST = 16;                 // adjacent lines that are processed together, as they share cache lines

// The lower envelope of the parabolas (u - s)² + line[s] along a line.
class Envelope {
public:
    explicit Envelope(size_t length) : place_(length), from_(length), line_(length) {}

    int64_t* line() { return line_.data(); }

    // Replaces each line()[u] by the minimum over all s of (u - s)² + line()[s].
    void settle() {
        const auto length = int64_t(line_.size());
        int64_t last = 0;
        place_[0] = from_[0] = 0;
        for (int64_t u = 1; u < length; ++u) {
            while (last >= 0 && at(from_[last], place_[last]) > at(from_[last], u)) --last;
            if (last < 0) {
                last = 0, place_[0] = u, from_[0] = 0;
            } else if (const int64_t begins = 1 + crossing(place_[last], u); begins < length) {
                ++last, place_[last] = u, from_[last] = begins;
            }
        }
        settled_.resize(line_.size());
        for (int64_t u = length - 1; u >= 0; --u) {
            settled_[u] = at(u, place_[last]);
            if (u == from_[last]) --last;
        }
        line_.swap(settled_);
    }

private:
    int64_t at(int64_t u, int64_t s) const { return (u - s) * (u - s) + line_[s]; }

    // The last position at which the parabola at `s` is not above the one at `u`, where u > s.
    int64_t crossing(int64_t s, int64_t u) const {
        const int64_t rise = u * u - s * s + line_[u] - line_[s], run = 2 * (u - s);
        return rise >= 0 ? rise / run : -((-rise + run - 1) / run);
    }

    std::vector<int64_t> place_, from_, line_, settled_;
};

// Settle `count` adjacent lines from `first` on, each of `length` values that are `stride` apart.
void settle(int64_t* first, size_t length, size_t stride, size_t count, std::vector<Envelope>& envelopes) {
    for (size_t u = 0; u < length; ++u)
        for (size_t i = 0; i < count; ++i) envelopes[i].line()[u] = first[u * stride + i];
    for (size_t i = 0; i < count; ++i) envelopes[i].settle();
    for (size_t u = 0; u < length; ++u)
        for (size_t i = 0; i < count; ++i) first[u * stride + i] = envelopes[i].line()[u];
}

void find_distances(Tensor<const bool, -1, -1, -1> solid, double resolution, Tensor<float, -1, -1, -1> distance,
                    size_t threads) {
    const size_t columns = solid.shape(0), rows = solid.shape(1), along = solid.shape(2), plane = rows * along;
    for (size_t axis = 0; axis < 3; ++axis)
        if (solid.shape(axis) != distance.shape(axis))
            throw std::invalid_argument("distance: expected the same shape as solid");
    const bool* from = solid.data();
    float* to = distance.data();
    const Release release;
    std::vector<int64_t> squared(columns * plane);
    parallel_for(columns, threads, [&](size_t, size_t x) {
        int64_t* slice = squared.data() + x * plane;
        for (size_t y = 0; y < rows; ++y) {
            int64_t* line = slice + y * along;
            const bool* here = from + x * plane + y * along;
            int64_t since = NOTHING;
            for (size_t z = 0; z < along; ++z) {
                since = here[z] ? 0 : since == NOTHING ? NOTHING : since + 1;
                line[z] = since;
            }
            since = NOTHING;
            for (size_t z = along; z-- > 0;) {
                since = here[z] ? 0 : since == NOTHING ? NOTHING : since + 1;
                const int64_t nearest = std::min(line[z], since);
                line[z] = nearest == NOTHING ? NOTHING : nearest * nearest;
            }
        }
        std::vector<Envelope> envelopes(std::min(ABREAST, along), Envelope(rows));
        for (size_t z = 0; z < along; z += ABREAST)
            settle(slice + z, rows, along, std::min(ABREAST, along - z), envelopes);
    });
    parallel_for(rows, threads, [&](size_t, size_t y) {
        std::vector<Envelope> envelopes(std::min(ABREAST, along), Envelope(columns));
        for (size_t z = 0; z < along; z += ABREAST) {
            const size_t count = std::min(ABREAST, along - z);
            settle(squared.data() + y * along + z, columns, plane, count, envelopes);
            for (size_t x = 0; x < columns; ++x)
                for (size_t i = 0; i < count; ++i) {
                    const size_t voxel = x * plane + y * along + z + i;
                    to[voxel] = squared[voxel] >= NOTHING ? std::numeric_limits<float>::infinity()
                                                          : float(std::sqrt(double(squared[voxel])) * resolution);
                }
        }
    });
}

}  // namespace

void bind_distances(nb::module_& m) {
    m.def("find_distances", &find_distances, nb::arg("solid"), nb::arg("resolution"), nb::arg("distance"),
          nb::arg("threads"));
}

}  // namespace splatrl
