#include <cmath>
#include <stdexcept>

#include "arrays.h"
#include "bindings.h"
#include "interpreter.h"
#include "kernel.h"
#include "levels.h"
#include "levels_binding.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

template <class T>
std::vector<T> values_of(const nb::dict& arrays, const char* name, size_t count) {
    const auto array = nb::cast<Tensor<const T, -1>>(arrays[name]);
    if (array.shape(0) != count)
        throw std::invalid_argument(std::string("levels.") + name + ": expected " + std::to_string(count) +
                                    " values, got " + std::to_string(array.shape(0)));
    poll();
    return std::vector<T>(array.data(), array.data() + count);
}

// The kernels follow these indices unchecked, so reject any that lead outside the arrays.
void check(const Levels& levels, size_t count) {
    const size_t nodes = levels.nodes.size();
    bool right = true;
    for (uint32_t item : levels.order) right = right && item < count;
    for (size_t i = 0; i < nodes && right; ++i) {
        if (i % 4096 == 0) poll();
        const Node& node = levels.nodes[i];
        const size_t held = node.leaf ? levels.order.size() : levels.opacities.size();
        right = node.count <= CLUSTER && size_t(node.first) + node.count <= held && node.skip > i && node.skip <= nodes;
        if (node.leaf)
            right = right && node.skip == i + 1 && node.count > 0 && node.error == 0.0f;
        else
            right = right && i + 1 < nodes && levels.nodes[i + 1].skip <= node.skip && node.error > 0.0f &&
                    (node.count > 0 || std::isinf(node.error));
    }
    if (!right)
        throw std::invalid_argument("levels: expected a tree over these Gaussians, got invalid indices or errors");
}

}  // namespace

Levels levels_of(const nb::dict& arrays, const GaussianArrays& gaussians) {
    const size_t nodes = nb::len(nb::object(arrays["errors"])), merged = nb::len(nb::object(arrays["opacities"]));
    Levels levels;
    levels.order = values_of<uint32_t>(arrays, "order", gaussians.count);
    const std::vector<uint32_t> table = values_of<uint32_t>(arrays, "nodes", 4 * nodes);
    const std::vector<float> errors = values_of<float>(arrays, "errors", nodes);
    for (size_t i = 0; i < nodes; ++i) {
        const uint32_t* row = &table[4 * i];
        levels.nodes.push_back({row[0], row[1], row[2], row[3], errors[i]});
    }
    levels.means = values_of<float>(arrays, "means", 3 * merged);
    levels.axes = values_of<float>(arrays, "axes", 9 * merged);
    levels.opacities = values_of<float>(arrays, "opacities", merged);
    levels.sh = values_of<float>(arrays, "sh", gaussians.colors() * merged);
    levels.members = values_of<float>(arrays, "members", merged);
    levels.sums = values_of<float>(arrays, "sums", merged);
    check(levels, gaussians.count);
    return levels;
}

void bind_levels(nb::module_& m) {
    m.def(
        "build_levels",
        [](Tensor<const float, -1, 3> means, Tensor<const float, -1, 3, 3> axes, Tensor<const float, -1> opacities,
           Tensor<const float, -1, -1, 3> sh, int degree) {
            const GaussianArrays gaussians{means.data(), axes.data(), opacities.data(), sh.data(), means.shape(0),
                                           degree};
            Levels levels;
            {
                const Release release;
                levels = build_levels(gaussians, CLUSTER, GROUP, true);
            }
            std::vector<uint32_t> table;
            std::vector<float> errors;
            for (const Node& node : levels.nodes) {
                table.insert(table.end(), {node.first, node.count, node.skip, node.leaf});
                errors.push_back(node.error);
            }
            const auto flat = [](auto values) {
                const size_t count = values.size();
                return to_numpy(std::move(values), {count});
            };
            nb::dict out;
            out["order"] = flat(std::move(levels.order));
            out["nodes"] = flat(std::move(table));
            out["errors"] = flat(std::move(errors));
            out["means"] = flat(std::move(levels.means));
            out["axes"] = flat(std::move(levels.axes));
            out["opacities"] = flat(std::move(levels.opacities));
            out["sh"] = flat(std::move(levels.sh));
            out["members"] = flat(std::move(levels.members));
            out["sums"] = flat(std::move(levels.sums));
            return out;
        },
        nb::arg("means"), nb::arg("axes"), nb::arg("opacities"), nb::arg("sh"), nb::arg("degree"));
}

}  // namespace splatrl
