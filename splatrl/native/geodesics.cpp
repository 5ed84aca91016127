// Lengths of shortest paths over the nodes of a grid, to several goals at a time, and its largest connected part.
//
// Columns are swept forwards and backwards until no distance becomes smaller. Each takes distances from the columns
// before it, where these have changed since it last did. A sweep follows all paths that never turn back across columns,
// so the number of sweeps is how often a path turns back.
//
// The order of this work has no influence on the result. The distance of a node is, to the last bit, the least of the
// sums over all paths, where a path's sum adds its lengths one after the other from the goal on, rounded to a double
// each time. As such sums never decrease along a path, Dijkstra's algorithm finds the same.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <memory>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "bindings.h"
#include "buffer.h"
#include "interpreter.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

constexpr size_t MOST_WAYS = 16;

// Nodes of a grid, numbered along its columns, and the ways between them. Way k leads from a node to the one that is
// `shift[k]` numbers later. Bit k of `onward` tells whether it is open from a node, and bit k of `back` whether it is
// open to a node.
struct Lattice {
    using Ways = Tensor<const uint16_t, -1, -1>;
    using Steps = Tensor<const int64_t, -1, 2>;

    int64_t columns, along;
    int64_t reach = 0, spread = 0;  // most columns that a way leads ahead, and most nodes that it leads aside
    size_t ways;
    int64_t shift[MOST_WAYS]{};
    unsigned level = 0;  // the bit of the way to the next node of the same column, or 0
    const uint16_t* onward;
    std::vector<uint16_t> back;

    Lattice(const Ways& open, const Steps& steps)
        : columns(int64_t(open.shape(0))), along(int64_t(open.shape(1))), ways(steps.shape(0)), onward(open.data()),
          back(open.size()) {
        if (ways > MOST_WAYS) throw std::invalid_argument("steps: expected at most 16");
        for (size_t k = 0; k < ways; ++k) {
            const int64_t x = steps.data()[2 * k], y = steps.data()[2 * k + 1];
            if (x == 0 && y == 1) level = 1u << k;
            else if (x < 1) throw std::invalid_argument("steps: expected (0, 1), or steps to later columns");
            shift[k] = x * along + y;
            reach = std::max(reach, x), spread = std::max(spread, std::abs(y));
        }
        for (int64_t node = 0; node < columns * along; ++node)
            for (unsigned left = onward[node]; left != 0; left &= left - 1) {
                const auto k = size_t(__builtin_ctz(left));
                if (k >= ways) throw std::invalid_argument("ways: expected no more bits than steps");
                const int64_t x = node / along + steps.data()[2 * k], y = node % along + steps.data()[2 * k + 1];
                if (x >= columns || y < 0 || y >= along)
                    throw std::invalid_argument("ways: expected ways that end on the grid");
                back[node + shift[k]] |= uint16_t(1u << k);
            }
    }
};

// Two doubles in one register of any processor.
typedef double Pair __attribute__((vector_size(16)));
typedef int64_t PairMask __attribute__((vector_size(16)));

// The distances from one node to several goals fill a cache line, and are computed together.
struct alignas(64) ToGoals {
    static constexpr size_t GOALS = 8, PAIRS = GOALS / 2;
    Pair metres[PAIRS];

    double to(size_t goal) const { return metres[goal / 2][goal % 2]; }

    // Take a way to another node, where this is shorter.
    void shorten(const ToGoals& there, double length) {
        for (size_t i = 0; i < PAIRS; ++i) {
            const Pair by = there.metres[i] + length;
            metres[i] = by < metres[i] ? by : metres[i];
        }
    }

    bool operator!=(const ToGoals& other) const {
        PairMask differs{};
        for (size_t i = 0; i < PAIRS; ++i) differs |= metres[i] != other.metres[i];
        return (differs[0] | differs[1]) != 0;
    }
};

// Successive nodes of a column.
struct Span {
    int64_t low = std::numeric_limits<int64_t>::max(), high = 0;

    bool empty() const { return low >= high; }
    void add(int64_t from, int64_t until) { low = std::min(low, from), high = std::max(high, until); }
};

// Computes distances to some goals at a time; a worker reuses its memory.
class Sweeper {
public:
    Sweeper(const Lattice& lattice, const double* lengths)
        : lattice_(lattice), lengths_(lengths), found_(make_buffer<ToGoals>(lattice.back.size())),
          forwards_(lattice, lattice.back.data(), 1), backwards_(lattice, lattice.onward, -1) {
        for (size_t k = 0; k < lattice.ways; ++k)
            if (lattice.level == 1u << k) level_length_ = lengths[k];
    }

    // Return the distances from all nodes to ToGoals::GOALS goals, infinite where there is no path.
    const ToGoals* settle(const int64_t* goals) {
        ToGoals unknown;
        std::fill_n(unknown.metres, ToGoals::PAIRS, std::numeric_limits<double>::infinity() + Pair{});
        std::fill_n(found_.get(), lattice_.back.size(), unknown);
        for (size_t i = 0; i < ToGoals::GOALS; ++i) found_[goals[i]].metres[i / 2][i % 2] = 0.0;
        for (size_t i = 0; i < ToGoals::GOALS; ++i) {
            const int64_t y = goals[i] % lattice_.along;
            pass_on(goals[i] / lattice_.along, {y, y + 1});
        }
        while (sweep(forwards_) | sweep(backwards_)) {
        }
        return found_.get();
    }

private:
    // A direction of travel across columns.
    struct Travel {
        const uint16_t* open;       // the ways by which each node is reached
        int64_t step;               // 1 or -1
        int64_t from[MOST_WAYS];    // where ways come from, relative to the node
        std::vector<Span> changed;  // the nodes of each column that may be nearer by way of those before it

        Travel(const Lattice& lattice, const uint16_t* ways, int64_t sign)
            : open(ways), step(sign), changed(size_t(lattice.columns)) {
            for (size_t k = 0; k < MOST_WAYS; ++k) from[k] = -sign * lattice.shift[k];
        }
    };

    // Let each column take distances from those before it. Returns whether any distance has become smaller.
    bool sweep(Travel& travel) {
        bool any = false;
        for (int64_t i = 0; i < lattice_.columns; ++i) {
            const int64_t x = travel.step > 0 ? i : lattice_.columns - 1 - i;
            if (travel.changed[x].empty()) continue;
            const Span shorter = take(travel, x, travel.changed[x]);
            travel.changed[x] = {};
            if (shorter.empty()) continue;
            pass_on(x, shorter);
            any = true;
        }
        return any;
    }

    // Let some nodes of a column take distances from the columns before it. Returns those that have become smaller.
    Span take(const Travel& travel, int64_t x, const Span& nodes) {
        const unsigned all = (1u << lattice_.ways) - 1;
        Span shorter;
        for (int64_t y = nodes.low; y < nodes.high; ++y) {
            const int64_t node = x * lattice_.along + y;
            unsigned left = travel.open[node];
            ToGoals best = found_[node];
            if (left == all)
                for (size_t k = 0; k < lattice_.ways; ++k) best.shorten(found_[node + travel.from[k]], lengths_[k]);
            else
                for (; left != 0; left &= left - 1) {
                    const int k = __builtin_ctz(left);
                    best.shorten(found_[node + travel.from[k]], lengths_[k]);
                }
            if (best != found_[node]) shorter.add(y, y + 1);
            found_[node] = best;
        }
        return shorter;
    }

    // Pass on the distances of some nodes within their column, and note whom they concern in others.
    void pass_on(int64_t x, Span nodes) {
        for (int64_t y = nodes.low + 1; y < lattice_.along; ++y) {
            const bool shorter = take_level(lattice_.back.data(), x * lattice_.along + y, -1);
            if (y >= nodes.high && !shorter) break;
            nodes.add(y, y + 1);
        }
        for (int64_t y = nodes.high - 2; y >= 0; --y) {
            const bool shorter = take_level(lattice_.onward, x * lattice_.along + y, 1);
            if (y < nodes.low && !shorter) break;
            nodes.add(y, y + 1);
        }
        const int64_t low = std::max<int64_t>(nodes.low - lattice_.spread, 0);
        const int64_t high = std::min(nodes.high + lattice_.spread, lattice_.along);
        for (int64_t k = 1; k <= lattice_.reach; ++k) {
            if (x + k < lattice_.columns) forwards_.changed[x + k].add(low, high);
            if (x >= k) backwards_.changed[x - k].add(low, high);
        }
    }

    // Let a node take distances from the next one of its column in one direction. Returns whether any becomes smaller.
    bool take_level(const uint16_t* open, int64_t node, int64_t from) {
        if ((open[node] & lattice_.level) == 0) return false;
        const ToGoals before = found_[node];
        found_[node].shorten(found_[node + from], level_length_);
        return found_[node] != before;
    }

    const Lattice& lattice_;
    const double* lengths_;
    double level_length_ = 0.0;
    Buffer<ToGoals> found_;
    Travel forwards_, backwards_;
};

void find_geodesics(Lattice::Ways ways, Lattice::Steps steps, Tensor<const double, -1> lengths,
                    Tensor<const int64_t, -1> goals, Tensor<const int64_t, -1, -1> nearest,
                    Tensor<const double, -1, -1> away, Tensor<float, -1, -1> metres, size_t threads) {
    const size_t count = goals.size(), nodes = ways.size(), together = ToGoals::GOALS;
    if (lengths.size() != steps.shape(0)) throw std::invalid_argument("lengths: expected one for each step");
    if (nearest.size() != nodes || away.size() != nodes || metres.shape(0) != count || metres.shape(1) != nodes)
        throw std::invalid_argument("find_geodesics: expected arrays for the same nodes and goals");
    const auto known = [&](int64_t node) { return node >= 0 && size_t(node) < nodes; };
    if (!std::all_of(goals.data(), goals.data() + count, known) ||
        !std::all_of(nearest.data(), nearest.data() + nodes, known))
        throw std::invalid_argument("goals, nearest: expected nodes of the grid");
    if (!std::all_of(lengths.data(), lengths.data() + lengths.size(), [](double length) { return length > 0.0; }))
        throw std::invalid_argument("lengths: expected positive ones");
    const Release release;
    const Lattice lattice(ways, steps);
    std::vector<std::unique_ptr<Sweeper>> sweepers(std::max<size_t>(threads, 1));
    parallel_for((count + together - 1) / together, threads, [&](size_t worker, size_t group) {
        if (!sweepers[worker]) sweepers[worker] = std::make_unique<Sweeper>(lattice, lengths.data());
        const size_t first = group * together;
        int64_t some[ToGoals::GOALS];
        for (size_t i = 0; i < together; ++i) some[i] = goals.data()[std::min(first + i, count - 1)];
        const ToGoals* found = sweepers[worker]->settle(some);
        for (size_t node = 0; node < nodes; ++node) {
            const ToGoals& here = found[nearest.data()[node]];
            for (size_t i = 0; i < std::min(together, count - first); ++i)
                metres.data()[(first + i) * nodes + node] = float(here.to(i) + away.data()[node]);
        }
    });
}

// Give a label to all nodes that ways connect with one. Returns how many they are.
size_t flood(const Lattice& lattice, int64_t first, uint32_t label, std::vector<uint32_t>& labels) {
    std::vector<int64_t> reached{first};
    labels[first] = label;
    const auto reach = [&](int64_t node) {
        if (labels[node] != 0) return;
        labels[node] = label;
        reached.push_back(node);
    };
    for (size_t next = 0; next < reached.size(); ++next) {
        const int64_t node = reached[next];
        for (unsigned left = lattice.onward[node]; left != 0; left &= left - 1)
            reach(node + lattice.shift[__builtin_ctz(left)]);
        for (unsigned left = lattice.back[node]; left != 0; left &= left - 1)
            reach(node - lattice.shift[__builtin_ctz(left)]);
    }
    return reached.size();
}

void find_largest_part(Lattice::Ways ways, Lattice::Steps steps, Tensor<const bool, -1, -1> nodes,
                       Tensor<bool, -1, -1> part) {
    if (nodes.size() != ways.size() || part.size() != ways.size())
        throw std::invalid_argument("find_largest_part: expected arrays for the same nodes");
    const Release release;
    const Lattice lattice(ways, steps);
    std::vector<uint32_t> labels(nodes.size());
    uint32_t count = 0, largest = 0;
    size_t most = 0;
    for (size_t node = 0; node < labels.size(); ++node) {
        if (!nodes.data()[node] || labels[node] != 0) continue;
        const size_t size = flood(lattice, int64_t(node), ++count, labels);
        if (size > most) most = size, largest = count;
    }
    for (size_t node = 0; node < labels.size(); ++node)
        part.data()[node] = nodes.data()[node] && labels[node] == largest;
}

}  // namespace

void bind_geodesics(nb::module_& m) {
    m.def("find_geodesics", &find_geodesics, nb::arg("ways"), nb::arg("steps"), nb::arg("lengths"), nb::arg("goals"),
          nb::arg("nearest"), nb::arg("away"), nb::arg("metres"), nb::arg("threads"));
    m.def("find_largest_part", &find_largest_part, nb::arg("ways"), nb::arg("steps"), nb::arg("nodes"),
          nb::arg("part"));
}

}  // namespace splatrl
