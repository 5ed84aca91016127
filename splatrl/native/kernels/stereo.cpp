// Kernels of plane-sweep stereo, compiled once for each instruction set.
#include "stereo.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <vector>

namespace splatrl {
namespace SPLATRL_ISA {

constexpr float NEVER = 1e9f;              // cost of what is impossible
constexpr float UNSEEN = 0.7f;             // cost of a place outside a neighbour's image
constexpr float FLAT = 1e-4f;              // variance at or below which a window carries little information
constexpr float STEP_COST = 0.3f;          // of a difference of one depth level between adjacent pixels
constexpr float JUMP_COST = 2.0f;          // of any larger difference, where both pixels have the same colour
constexpr float LEAST_JUMP_COST = 0.45f;   // of any larger difference across an edge
constexpr float EDGE = 10.0f;              // how fast JUMP_COST decays with the difference of two pixels
constexpr float SOUNDING_COST = 0.25f;     // per level away from a known depth, up to MOST_LEVELS of them
constexpr float MOST_LEVELS = 6.0f;

// Sum the window around each pixel, along rows and then along columns; only pixels within the image count.
static void window_sums(const float* __restrict in, int width, int height, float* __restrict line,
                        float* __restrict out) {
    constexpr int R = STEREO_RADIUS;
    for (int y = 0; y < height; ++y) {
        const float* __restrict row = in + size_t(y) * size_t(width);
        float* __restrict to = line + size_t(y) * size_t(width);
        for (int x = R; x < width - R; ++x) to[x] = row[x - 2] + row[x - 1] + row[x] + row[x + 1] + row[x + 2];
        for (int x = 0; x < width; x = x + 1 == R && width > 2 * R ? width - R : x + 1) {
            float sum = 0.0f;
            for (int k = std::max(0, x - R); k <= std::min(width - 1, x + R); ++k) sum += row[k];
            to[x] = sum;
        }
    }
    for (int y = 0; y < height; ++y) {
        float* __restrict to = out + size_t(y) * size_t(width);
        std::memset(to, 0, sizeof(float) * size_t(width));
        for (int k = std::max(0, y - R); k <= std::min(height - 1, y + R); ++k) {
            const float* __restrict from = line + size_t(k) * size_t(width);
            for (int x = 0; x < width; ++x) to[x] += from[x];
        }
    }
}

// The reciprocal of the number of pixels in each window.
static void window_shares(int width, int height, float* out) {
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const int across = std::min(width - 1, x + STEREO_RADIUS) - std::max(0, x - STEREO_RADIUS) + 1;
            const int down = std::min(height - 1, y + STEREO_RADIUS) - std::max(0, y - STEREO_RADIUS) + 1;
            out[size_t(y) * size_t(width) + size_t(x)] = 1.0f / float(across * down);
        }
}

// Maps the pixels of a photo to a neighbour, in homogeneous coordinates: turn · (column, row, 1) + inverse depth ·
// shift.
struct Warp {
    float turn[9], shift[3];
};

static Warp warp_between(const StereoPhotos& photos, size_t from, size_t to) {
    const float *a = photos.camera_to_world + 16 * from, *b = photos.camera_to_world + 16 * to, *K = photos.K;
    double relative[9], away[3];  // pose of camera `from` in the frame of camera `to`
    for (int i = 0; i < 3; ++i) {
        away[i] = 0.0;
        for (int k = 0; k < 3; ++k) away[i] += double(b[4 * k + i]) * (double(a[4 * k + 3]) - double(b[4 * k + 3]));
        for (int j = 0; j < 3; ++j) {
            relative[3 * i + j] = 0.0;
            for (int k = 0; k < 3; ++k) relative[3 * i + j] += double(b[4 * k + i]) * double(a[4 * k + j]);
        }
    }
    Warp out;
    const double fx = K[0], fy = K[4], cx = K[2], cy = K[5];
    for (int row = 0; row < 3; ++row) {
        const double scale = row == 0 ? fx : row == 1 ? fy : 1.0, centre = row == 0 ? cx : row == 1 ? cy : 0.0;
        double turned[3];
        for (int j = 0; j < 3; ++j) turned[j] = scale * relative[3 * row + j] + centre * relative[6 + j];
        out.turn[3 * row] = float(turned[0] / fx), out.turn[3 * row + 1] = float(turned[1] / fy);
        out.turn[3 * row + 2] = float(turned[2] - turned[0] * cx / fx - turned[1] * cy / fy);
        out.shift[row] = float(scale * away[row] + centre * away[2]);
    }
    return out;
}

// Warp a neighbour to the photo's view, as if everything were at one inverse depth. `outside` is 1 where a pixel falls
// outside the neighbour.
static void draw_warped(const StereoPhotos& photos, const Warp& warp, size_t neighbour, float inverse,
                        float* __restrict out, float* __restrict outside) {
    const float* __restrict image = photos.grey + neighbour * photos.area();
    const float last_x = float(photos.width - 1), last_y = float(photos.height - 1);
    const int stride = photos.width;
    for (int y = 0; y < photos.height; ++y) {
        const float down = float(y) + 0.5f;
        float start[3];
        for (int i = 0; i < 3; ++i)
            start[i] = warp.turn[3 * i + 1] * down + warp.turn[3 * i + 2] + inverse * warp.shift[i];
        float* __restrict to = out + size_t(y) * size_t(stride);
        float* __restrict beyond = outside + size_t(y) * size_t(stride);
        for (int x = 0; x < stride; ++x) {
            const float across = float(x) + 0.5f;
            const float z = start[2] + warp.turn[6] * across, scale = 1.0f / (z > 1e-6f ? z : 1e-6f);
            const float u = (start[0] + warp.turn[0] * across) * scale - 0.5f;
            const float v = (start[1] + warp.turn[3] * across) * scale - 0.5f;
            const bool in = z > 0.0f && u >= -0.5f && v >= -0.5f && u <= last_x + 0.5f && v <= last_y + 0.5f;
            beyond[x] = in ? 0.0f : 1.0f;
            const float cu = u > 0.0f ? (u < last_x ? u : last_x) : 0.0f,
                cv = v > 0.0f ? (v < last_y ? v : last_y) : 0.0f;
            const int left = int(cu) < stride - 1 ? int(cu) : std::max(stride - 2, 0);
            const int top = int(cv) < photos.height - 1 ? int(cv) : std::max(photos.height - 2, 0);
            const float a = cu - float(left), b = cv - float(top);
            const int right = stride > 1 ? 1 : 0, below = photos.height > 1 ? stride : 0;
            const float* from = image + top * stride + left;
            const float upper = from[0] + a * (from[right] - from[0]);
            const float lower = from[below] + a * (from[below + right] - from[below]);
            to[x] = upper + b * (lower - upper);
        }
    }
}

// Write the matching costs of all inverse depths to `volume` [area, depths]: one minus the normalised cross-correlation
// of the windows, averaged over the STEREO_BEST neighbours that agree best.
static void match(const StereoPhotos& photos, const StereoTask& task, const StereoScratch& scratch) {
    const size_t area = photos.area();
    const int width = photos.width, height = photos.height;
    auto plane = [&](StereoPlane which) { return scratch.planes + size_t(which) * area; };
    const float* own = photos.grey + task.photo * area;
    float *a = plane(SUM), *b = plane(SUM_OF_SQUARES), *c = plane(SUM_OF_PRODUCTS), *shares = plane(SHARE);
    float *mean = plane(OWN_MEAN), *variance = plane(OWN_VARIANCE), *warped = plane(WARPED), *outside = plane(OUTSIDE);
    float* line = plane(LINE);
    window_shares(width, height, shares);
    for (size_t i = 0; i < area; ++i) b[i] = own[i] * own[i];
    window_sums(own, width, height, line, a);
    window_sums(b, width, height, line, c);
    for (size_t i = 0; i < area; ++i) {
        mean[i] = a[i] * shares[i];
        variance[i] = std::max(c[i] * shares[i] - mean[i] * mean[i], 0.0f) + FLAT;
    }
    for (size_t n = 0; n < task.neighbour_count; ++n) {
        const Warp warp = warp_between(photos, task.photo, size_t(task.neighbours[n]));
        for (int level = 0; level < task.depths; ++level) {
            const float inverse = task.low + (task.high - task.low) * float(level) / float(task.depths - 1);
            draw_warped(photos, warp, size_t(task.neighbours[n]), inverse, warped, outside);
            float *squares = plane(SQUARES), *products = plane(PRODUCTS);
            for (size_t i = 0; i < area; ++i) squares[i] = warped[i] * warped[i], products[i] = warped[i] * own[i];
            window_sums(warped, width, height, line, a);
            window_sums(squares, width, height, line, b);
            window_sums(products, width, height, line, c);
            float* __restrict best[STEREO_BEST];
            for (int k = 0; k < STEREO_BEST; ++k)
                best[k] = scratch.best + (size_t(k) * size_t(task.depths) + size_t(level)) * area;
            for (size_t i = 0; i < area; ++i) {
                const float there = a[i] * shares[i];
                const float spread = std::max(b[i] * shares[i] - there * there, 0.0f) + FLAT;
                const float likeness = (c[i] * shares[i] - there * mean[i]) / std::sqrt(spread * variance[i]);
                float cost = outside[i] > 0.0f ? UNSEEN : std::min(std::max(1.0f - likeness, 0.0f), 1.0f);
                for (int k = 0; k < STEREO_BEST; ++k) {
                    const float kept = n <= size_t(k) ? NEVER : best[k][i];
                    best[k][i] = std::min(kept, cost);
                    cost = std::max(kept, cost);
                }
            }
        }
    }
    const int counted = int(std::min(task.neighbour_count, size_t(STEREO_BEST)));
    const size_t whole = size_t(task.depths) * area;
    for (int level = 0; level < task.depths; ++level) {
        const float* from = scratch.best + size_t(level) * area;
        for (size_t i = 0; i < area; ++i) {
            float sum = 0.0f;
            for (int k = 0; k < counted; ++k) sum += from[size_t(k) * whole + i];
            scratch.volume[i * size_t(task.depths) + size_t(level)] = sum / float(counted);
        }
    }
}

static void prefer_soundings(const StereoPhotos& photos, const StereoTask& task, const StereoScratch& scratch) {
    for (size_t s = 0; s < task.sounding_count; ++s) {
        const float* at = task.soundings + 3 * s;
        const int x = int(at[0]), y = int(at[1]);
        if (at[0] < 0.0f || at[1] < 0.0f || x >= photos.width || y >= photos.height) continue;
        const float found = (at[2] - task.low) / (task.high - task.low) * float(task.depths - 1);
        float* costs = scratch.volume + (size_t(y) * size_t(photos.width) + size_t(x)) * size_t(task.depths);
        for (int level = 0; level < task.depths; ++level)
            costs[level] += SOUNDING_COST * std::min(std::fabs(float(level) - found), MOST_LEVELS);
    }
}

// One step of a path from a pixel to the next: out = cost + the cheapest transition from `before`, relative to the
// minimum of `before`.
static void step(const float* __restrict cost, const float* __restrict before, int depths, float jump,
                 float* __restrict out, float* __restrict total) {
    float least = before[0];
    for (int d = 1; d < depths; ++d) least = std::min(least, before[d]);
    const float most = least + jump;
    for (int d = 0; d < depths; ++d) {  // `before` is padded with one large value on either side
        const float beside = std::min(before[d - 1], before[d + 1]) + STEP_COST;
        out[d] = cost[d] + std::min(std::min(before[d], beside), most) - least;
    }
    for (int d = 0; d < depths; ++d) total[d] += out[d];
}

// Add the costs along the paths in one direction: `lines` parallel paths, `side` apart in memory, along which pixels
// are `next` apart.
static void smooth(const StereoTask& task, const StereoScratch& scratch, const float* grey, size_t first,
                   ptrdiff_t next, int length, ptrdiff_t side, int lines) {
    constexpr int MOST = 256;
    const int depths = task.depths;
    float rows[2][MOST + 2];
    for (int line = 0; line < lines; ++line) {
        ptrdiff_t at = ptrdiff_t(first) + line * side;
        for (float* row : {rows[0], rows[1]}) row[0] = row[depths + 1] = NEVER;
        const float* costs = scratch.volume + size_t(at) * size_t(depths);
        std::copy_n(costs, depths, rows[0] + 1);
        float* total = scratch.total + size_t(at) * size_t(depths);
        for (int d = 0; d < depths; ++d) total[d] += costs[d];
        for (int i = 1; i < length; ++i) {
            const float edge = std::fabs(grey[at + next] - grey[at]);
            at += next;
            const float jump = std::max(LEAST_JUMP_COST, JUMP_COST * std::exp(-EDGE * edge));
            step(scratch.volume + size_t(at) * size_t(depths), rows[(i + 1) % 2] + 1, depths, jump, rows[i % 2] + 1,
                 scratch.total + size_t(at) * size_t(depths));
        }
    }
}

static void sweep(const StereoPhotos& photos, const StereoTask& task, const StereoScratch& scratch, float* out) {
    const size_t area = photos.area(), depths = size_t(task.depths);
    const int width = photos.width, height = photos.height;
    const float* grey = photos.grey + task.photo * area;
    match(photos, task, scratch);
    prefer_soundings(photos, task, scratch);
    std::fill(scratch.total, scratch.total + area * depths, 0.0f);
    smooth(task, scratch, grey, 0, 1, width, width, height);
    smooth(task, scratch, grey, size_t(width - 1), -1, width, width, height);
    smooth(task, scratch, grey, 0, width, height, 1, width);
    smooth(task, scratch, grey, size_t(height - 1) * size_t(width), -width, height, 1, width);
    for (size_t i = 0; i < area; ++i) {
        const float* costs = scratch.total + i * depths;
        size_t best = 0;
        for (size_t d = 1; d < depths; ++d)
            if (costs[d] < costs[best]) best = d;
        float place = float(best);
        if (best > 0 && best + 1 < depths) {  // refined to the lowest point of a parabola
            const float bend = costs[best - 1] - 2.0f * costs[best] + costs[best + 1];
            const float off = 0.5f * (costs[best - 1] - costs[best + 1]) / std::max(bend, 1e-6f);
            place += std::min(std::max(off, -0.5f), 0.5f);
        }
        out[i] = task.low + (task.high - task.low) * place / float(depths - 1);
    }
}

static void agree(const StereoPhotos& photos, const StereoTask& task, const float* inverse, float tolerance, int least,
                  float* out) {
    const float* own = inverse + task.photo * photos.area();
    std::vector<Warp> warps;
    for (size_t n = 0; n < task.neighbour_count; ++n)
        warps.push_back(warp_between(photos, task.photo, size_t(task.neighbours[n])));
    for (int y = 0; y < photos.height; ++y)
        for (int x = 0; x < photos.width; ++x) {
            const float here = *own++;
            int count = 0;
            float sum = 1.0f;
            for (size_t n = 0; n < warps.size() && here > 0.0f; ++n) {
                const float *turn = warps[n].turn, *shift = warps[n].shift;
                float ahead[3];
                for (int i = 0; i < 3; ++i)
                    ahead[i] = turn[3 * i] * (float(x) + 0.5f) + turn[3 * i + 1] * (float(y) + 0.5f) +
                               turn[3 * i + 2] + here * shift[i];
                const float u = ahead[0] / ahead[2], v = ahead[1] / ahead[2];
                if (!(ahead[2] > 0.0f && u >= 0.0f && v >= 0.0f && u < float(photos.width) && v < float(photos.height)))
                    continue;
                const size_t place = size_t(v) * size_t(photos.width) + size_t(u);
                const float theirs = inverse[size_t(task.neighbours[n]) * photos.area() + place];
                const float ratio = theirs * ahead[2] / here;
                if (std::fabs(ratio - 1.0f) < tolerance) ++count, sum += ratio;
            }
            *out++ = count >= least ? here * sum / float(1 + count) : 0.0f;
        }
}

extern const StereoKernels stereo_kernels = {sweep, agree};

}  // namespace SPLATRL_ISA
}  // namespace splatrl
