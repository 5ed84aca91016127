#include "levels.h"

#include <cmath>
#include <limits>
#include <numeric>

#include "kd_order.h"
#include "splat.h"
#include "threads.h"

namespace splatrl {

namespace {

constexpr size_t BUCKET = 64;          // neighbours among which each item's merge partner is searched for
constexpr double LARGEST_AREA = 1e30;  // square metres: sums of masses do not overflow
constexpr float LARGEST_COST = 1e38f;  // less than NEVER, so that any pair can be merged
constexpr float LEAST_CONTRAST = 0.2f;  // merging equal colours also has a cost, because it moves edges

// A Gaussian, or several merged into one that has their total mass, mean and covariance.
struct Item {
    float mean[3];
    float covariance[6];  // xx, xy, xz, yy, yz, zz
    float mass;           // opacity times mean projected area, square metres
    float squares;        // sum of its members' squared masses
    float sum;            // sum of its members' opacities
    float spread;         // mass-weighted variance of its members' means, square metres
    std::vector<float> sh;
};

// The area, divided by π, of the ellipse that a Gaussian projects to, as a root mean square over all directions, from a
// factor A of its covariance: sqrt(tr(adj A Aᵀ) / 3), the sum of the squared 2×2 minors of A (Cauchy–Binet), which are
// exact however thin the Gaussian.
float area_of(const float* axes) {
    double sum = 0.0;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            const float *a = axes + 3 * i, *b = axes + 3 * ((i + 1) % 3);
            const int k = (j + 1) % 3;
            const double minor = double(a[j]) * b[k] - double(a[k]) * b[j];
            sum += minor * minor;
        }
    return float(std::fmin(std::sqrt(sum / 3.0), LARGEST_AREA));
}

Item item_of(const GaussianArrays& gaussians, uint32_t index) {
    Item item{};
    std::copy_n(gaussians.means + 3 * size_t(index), 3, item.mean);
    const float* axes = gaussians.axes + 9 * size_t(index);
    float* covariance = item.covariance;
    for (int row = 0; row < 3; ++row)
        for (int column = row; column < 3; ++column, ++covariance)
            for (int axis = 0; axis < 3; ++axis) *covariance += axes[3 * row + axis] * axes[3 * column + axis];
    item.sum = gaussians.opacities[index];
    item.mass = item.sum * area_of(axes);
    item.squares = item.mass * item.mass;
    const float* sh = gaussians.sh + gaussians.colors() * index;
    item.sh.assign(sh, sh + gaussians.colors());
    return item;
}

float squared_distance(const float* a, const float* b) {
    float sum = 0.0f;
    for (int i = 0; i < 3; ++i) sum += (a[i] - b[i]) * (a[i] - b[i]);
    return sum;
}

// The cost of merging two items: the mass that moves, weighted by its squared displacement and the colour contrast.
float cost_of(const Item& a, const Item& b) {
    const float contrast = SH_C0 * SH_C0 * squared_distance(a.sh.data(), b.sh.data());
    const float mass = a.mass + b.mass, moved = mass > 0.0f ? a.mass * b.mass / mass : 0.0f;
    const float cost = moved * squared_distance(a.mean, b.mean) * (LEAST_CONTRAST * LEAST_CONTRAST + contrast);
    return cost < LARGEST_COST ? cost : LARGEST_COST;
}

// Merge `b` into `a`, which gets the mass, mean and covariance of the whole, and the mass-weighted mean colour.
void absorb(Item& a, const Item& b) {
    const float mass = a.mass + b.mass, share = mass > 0.0f ? b.mass / mass : 0.5f, both = share * (1.0f - share);
    float between[3];
    for (int i = 0; i < 3; ++i) between[i] = b.mean[i] - a.mean[i];
    int k = 0;
    for (int row = 0; row < 3; ++row)
        for (int column = row; column < 3; ++column, ++k)
            a.covariance[k] += share * (b.covariance[k] - a.covariance[k]) + both * between[row] * between[column];
    a.spread += share * (b.spread - a.spread) + both * squared_distance(a.mean, b.mean);
    for (int i = 0; i < 3; ++i) a.mean[i] += share * between[i];
    for (size_t i = 0; i < a.sh.size(); ++i) a.sh[i] += share * (b.sh[i] - a.sh[i]);
    a.mass = mass;
    a.squares += b.squares;
    a.sum += b.sum;
}

// The cheapest merge partner of each item within its bucket.
class Partners {
public:
    explicit Partners(std::vector<Item>& items)
        : items_(items), cost_(items.size(), NEVER), partner_(items.size()), gone_(items.size(), false) {
        for (size_t i = 0; i < items.size(); ++i) search(i);
    }

    // Merge the cheapest pair; returns false if none is left.
    bool merge_cheapest() {
        const size_t i = size_t(std::min_element(cost_.begin(), cost_.end()) - cost_.begin());
        if (cost_[i] == NEVER) return false;
        const size_t j = partner_[i];
        absorb(items_[i], items_[j]);
        gone_[j] = true, cost_[j] = NEVER;
        search(i);
        for (size_t k = first_of(i); k < last_of(i); ++k) {
            if (gone_[k] || k == i) continue;
            if (partner_[k] == i || partner_[k] == j)
                search(k);
            else
                offer(k, i);
        }
        return true;
    }

    bool gone(size_t i) const { return gone_[i]; }

private:
    static constexpr float NEVER = std::numeric_limits<float>::infinity();

    size_t first_of(size_t i) const { return i / BUCKET * BUCKET; }
    size_t last_of(size_t i) const { return std::min(items_.size(), first_of(i) + BUCKET); }

    void offer(size_t i, size_t j) {
        const float cost = cost_of(items_[i], items_[j]);
        if (cost < cost_[i]) cost_[i] = cost, partner_[i] = j;
    }

    void search(size_t i) {
        cost_[i] = NEVER;
        for (size_t j = first_of(i); j < last_of(i); ++j)
            if (j != i && !gone_[j]) offer(i, j);
    }

    std::vector<Item>& items_;
    std::vector<float> cost_;
    std::vector<size_t> partner_;
    std::vector<bool> gone_;
};

std::vector<Item> in_space(std::vector<Item>& items, size_t run) {
    std::vector<uint32_t> order(items.size());
    std::iota(order.begin(), order.end(), 0u);
    order_in_space(order.data(), order.data() + order.size(), run, [&](uint32_t i) { return items[i].mean; });
    std::vector<Item> ordered;
    ordered.reserve(items.size());
    for (uint32_t i : order) ordered.push_back(std::move(items[i]));
    return ordered;
}

// Merge the cheapest pairs of neighbours until only `target` items are left.
std::vector<Item> merged(std::vector<Item> items, size_t target) {
    items = in_space(items, BUCKET);
    Partners partners(items);
    for (size_t left = items.size(); left > target && partners.merge_cheapest();) --left;
    std::vector<Item> kept;
    for (size_t i = 0; i < items.size(); ++i)
        if (!partners.gone(i)) kept.push_back(std::move(items[i]));
    return kept;
}

// The Cholesky factor A of a covariance, Σ = A Aᵀ, row-major.
void factor_of(const float* c, float* axes) {
    constexpr double LEAST = 1e-20;
    const double xx = std::sqrt(std::max(double(c[0]), LEAST)), yx = c[1] / xx, zx = c[2] / xx;
    const double yy = std::sqrt(std::max(c[3] - yx * yx, LEAST)), zy = (c[4] - zx * yx) / yy;
    const double zz = std::sqrt(std::max(c[5] - zx * zx - zy * zy, LEAST));
    const double rows[9] = {xx, 0.0, 0.0, yx, yy, 0.0, zx, zy, zz};
    std::copy_n(rows, 9, axes);
}

class Builder {
public:
    Builder(const GaussianArrays& gaussians, size_t capacity, size_t run, bool merge)
        : gaussians_(gaussians), capacity_(capacity), run_(run), merge_(merge) {
        levels.order.resize(gaussians.count);
        std::iota(levels.order.begin(), levels.order.end(), 0u);
        uint32_t* first = levels.order.data();
        if (gaussians.count == 0) return;
        std::vector<Item> items = build(first, first + gaussians.count);
        if (merge_) top(std::move(items));
    }

    Levels levels;

private:
    // Append the node over [first, last) and its whole subtree. Returns its Gaussians, to be merged further up.
    std::vector<Item> build(uint32_t* first, uint32_t* last) {
        poll();
        const auto mean = [this](uint32_t i) { return gaussians_.means + 3 * size_t(i); };
        const size_t index = levels.nodes.size();
        const bool leaf = size_t(last - first) <= capacity_;
        levels.nodes.push_back({uint32_t(first - levels.order.data()), uint32_t(last - first), 0, leaf, 0.0f});
        std::vector<Item> items;
        if (leaf) {
            order_in_space(first, last, run_, mean);
            if (merge_)
                for (const uint32_t* item = first; item != last; ++item) items.push_back(item_of(gaussians_, *item));
        } else {
            uint32_t* middle = split(first, last, capacity_, mean);
            items = build(first, middle);
            for (Item& item : build(middle, last)) items.push_back(std::move(item));
            items = merged(std::move(items), capacity_);
            items = in_space(items, run_);
            show(levels.nodes[index], items);
        }
        levels.nodes[index].skip = uint32_t(levels.nodes.size());
        return items;
    }

    // Put nodes with fewer and fewer Gaussians above the root, each with the next as its only child: a model that is
    // small or distant needs fewer Gaussians than a node holds.
    void top(std::vector<Item> items) {
        std::vector<Node> above;
        for (size_t target = fewer(items.size()); target > 0; target = fewer(items.size())) {
            const size_t before = items.size();
            items = merged(std::move(items), target);
            items = in_space(items, run_);
            if (items.size() == before) break;
            above.push_back({});
            show(above.back(), items);
        }
        std::reverse(above.begin(), above.end());
        levels.nodes.insert(levels.nodes.begin(), above.begin(), above.end());
        for (size_t i = 0; i < levels.nodes.size(); ++i) {
            Node& node = levels.nodes[i];
            node.skip = uint32_t(i < above.size() ? levels.nodes.size() : node.skip + above.size());
        }
    }

    // Three quarters of a count, rounded down to whole runs.
    size_t fewer(size_t count) const { return count * 3 / 4 / run_ * run_; }

    // Store these items as the merged Gaussians of an inner node.
    void show(Node& node, const std::vector<Item>& items) {
        node.first = uint32_t(levels.opacities.size());
        node.count = uint32_t(items.size());
        node.error = merge_ ? error_of(items) : std::numeric_limits<float>::infinity();
        for (const Item& item : items) append(item);
    }

    void append(const Item& item) {
        float axes[9];
        factor_of(item.covariance, axes);
        levels.means.insert(levels.means.end(), item.mean, item.mean + 3);
        levels.axes.insert(levels.axes.end(), axes, axes + 9);
        levels.opacities.push_back(item.mass / area_of(axes));
        levels.sh.insert(levels.sh.end(), item.sh.begin(), item.sh.end());
        levels.members.push_back(item.squares > 0.0f ? item.mass * item.mass / item.squares : 1.0f);
        levels.sums.push_back(item.sum);
    }

    // The mass-weighted root mean square displacement of the members, infinite if it overflows; never 0, which marks a
    // leaf.
    static float error_of(const std::vector<Item>& items) {
        double sum = 0.0, mass = 0.0;
        for (const Item& item : items) sum += double(item.mass) * item.spread, mass += item.mass;
        const float error = mass > 0.0 ? float(std::sqrt(sum / mass)) : 0.0f;
        return std::isnan(error) ? std::numeric_limits<float>::infinity()
                                 : std::max(error, std::numeric_limits<float>::min());
    }

    const GaussianArrays& gaussians_;
    size_t capacity_, run_;
    bool merge_;
};

}  // namespace

Levels build_levels(const GaussianArrays& gaussians, size_t capacity, size_t run, bool merge) {
    return std::move(Builder(gaussians, capacity, run, merge).levels);
}

}  // namespace splatrl
