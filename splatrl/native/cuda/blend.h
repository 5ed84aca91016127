// From sorted keys to pixels. Each warp holds four patches of 8×4 pixels in its registers, a pixel of each in a lane.
#pragma once

#include "order.h"
#include "tile.h"

namespace splatrl {

constexpr int QUAD = 4;  // patches per warp

struct Color {
    float red, green, blue;
};

// The colour of the Gaussian in a slot, seen along `offset`, relative to the background; rounded to half floats, as on
// the CPU.
SPLAT_INLINE Color color_of(const SceneArrays& scene, uint32_t slot, const Vector<float>& offset) {
    constexpr int HARMONICS = harmonics_of(SH_DEGREE), STRIDE = color_stride(SH_DEGREE);
    const uint16_t* coefficients = scene.colors + size_t(slot) * STRIDE;
    if (SH_DEGREE == 0)
        return {half_to_float(coefficients[0]), half_to_float(coefficients[1]), half_to_float(coefficients[2])};
    const float squared = offset.x * offset.x + offset.y * offset.y + offset.z * offset.z;
    const float inverse = reciprocal_sqrt(max(squared, 1e-30f));
    float basis[16], sums[3] = {0.5f, 0.5f, 0.5f};
    sh_basis(SH_DEGREE, offset.x * inverse, offset.y * inverse, offset.z * inverse, basis);
    const uint2* words = reinterpret_cast<const uint2*>(coefficients);  // four half floats each
#pragma unroll
    for (int word = 0; word < STRIDE / 4; ++word) {
        const uint2 four = words[word];
        const uint32_t halves[2] = {four.x, four.y};
#pragma unroll
        for (int i = 0; i < 4; ++i) {
            const int at = 4 * word + i;
            const uint16_t coefficient = uint16_t(halves[i / 2] >> 16 * (i % 2));
            if (at < 3 * HARMONICS) sums[at % 3] += basis[at / 3] * half_to_float(coefficient);
        }
    }
    float out[3];
    for (int i = 0; i < 3; ++i) out[i] = rounded_to_half(max(sums[i], 0.0f) - scene.background[i]);
    return {out[0], out[1], out[2]};
}

// The projection of the Gaussian in a slot.
SPLAT_INLINE Footprint<float> footprint_of(const SceneArrays& scene, const Camera& camera, uint32_t slot,
                                           const Vector<float>& offset, float log2_invisible) {
    const float4* shape = scene.shapes + 3 * size_t(slot);
    const float4 a = shape[0], b = shape[1], c = shape[2];
    const float axes[9] = {a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w, c.x};
    return project<ANTIALIASED_IMAGE, WITH_LEVELS>(camera, offset, axes, c.y, Merging<float>{c.z, c.w},
                                                   log2_invisible);
}

// The part to which an index of the row belongs.
SPLAT_INLINE int part_of(const Views& views, const Shared& shared, uint32_t index) {
    return WITH_PARTS ? behind_last(shared.bases, 0, views.parts, index) - 1 : 0;
}

// The slot of the Gaussian with an index of the row.
SPLAT_INLINE uint32_t slot_of(const SceneArrays& scene, const Views& views, const Shared& shared, int part,
                              uint32_t index) {
    return scene.slots[WITH_PARTS ? index + place_of(views, shared.row, part).shift : index];
}

// The row's camera in the frame of a part.
SPLAT_INLINE Camera camera_of_part(const Views& views, const Shared& shared, int part) {
    Camera camera = shared.camera;
    if (!WITH_PARTS) return camera;
    const Place& place = place_of(views, shared.row, part);
    const float4* rows = reinterpret_cast<const float4*>(place.camera_to_model);
    for (int row = 0; row < 3; ++row) {
        const float4 values = rows[row];
        camera.rotation[row] = values.x, camera.rotation[3 + row] = values.y, camera.rotation[6 + row] = values.z;
        camera.position[row] = values.w;
    }
    return camera;
}

// Project the Gaussians of a sorted slab, colour those that show, and lay them out in their order. Returns how many.
SPLAT_INLINE uint32_t load_slab(const SceneArrays& scene, const Views& views, Shared& shared, uint32_t count) {
    const float log2_invisible = log2_invisible_at(scene.tolerance, ANTIALIASED_IMAGE);
    uint32_t shown = 0;
    for (uint32_t begin = 0; begin < count; begin += THREADS) {
        const uint32_t i = begin + thread();
        uint32_t slot = 0, patches = 0;
        Vector<float> offset{};
        Footprint<float> print{};
        if (i < count) {
            const uint32_t index = uint32_t(shared.sorted[i]) & ((1u << INDEX_BITS) - 1);
            const int part = part_of(views, shared, index);
            slot = slot_of(scene, views, shared, part, index);
            const float4 sphere = scene.spheres[slot];
            const Camera camera = camera_of_part(views, shared, part);
            offset = {sphere.x - camera.position[0], sphere.y - camera.position[1], sphere.z - camera.position[2]};
            print = footprint_of(scene, camera, slot, offset, log2_invisible);
            patches = covered_patches(print, shared.tile, log2_invisible);
        }
        const uint32_t lanes = __ballot_sync(ALL_LANES, patches != 0);
        if (lane() == 0) shared.sums[warp()] = __popc(lanes);
        __syncthreads();
        uint32_t place = shown + rank_in(lanes);
        for (int i = 0; i < WARPS; ++i) {
            if (i < warp()) place += shared.sums[i];
            shown += shared.sums[i];
        }
        if (patches != 0) {
            shared.patches[place] = patches;
            Record& record = shared.records[place];
            record.place = make_float4(print.x, print.y, print.l11, print.l12);
            record.fall = make_float4(print.l22, print.log2_opacity, rounded_to_half(print.peak), print.depth);
            const Color color = color_of(scene, slot, offset);
            record.color = make_float4(color.red, color.green, color.blue, 0.0f);
        }
        __syncthreads();
    }
    return shown;
}

// What a lane accumulates: a pixel of each of its warp's patches.
template <bool WITH_DEPTH>
struct Pixels {
    float red[QUAD], green[QUAD], blue[QUAD], transmittance[QUAD], depth[QUAD], alpha[QUAD];
    float finished;      // the transmittance at which a pixel is
    float log2_invisible;
    float x, y;          // of the lane's pixel in the first patch
    uint32_t active;     // patches that are not finished, by bits
    uint32_t blended;    // pairs of a splat and a patch: this lane's share

    INLINE_MEMBER void begin(const SceneArrays& scene, const Tile& tile) {
        const int column = tile.left + warp() % 2 * 2 * PATCH_WIDTH + lane() % PATCH_WIDTH;
        const int row = tile.top + warp() / 2 * 2 * PATCH_HEIGHT + lane() / PATCH_WIDTH;
        finished = finished_at(scene.tolerance);
        log2_invisible = log2_invisible_at(scene.tolerance, ANTIALIASED_IMAGE);
        x = float(column) + 0.5f, y = float(row) + 0.5f, blended = 0;
#pragma unroll
        for (int i = 0; i < QUAD; ++i) {
            const bool inside = column + i % 2 * PATCH_WIDTH < tile.right && row + i / 2 * PATCH_HEIGHT < tile.bottom;
            red[i] = scene.background[0], green[i] = scene.background[1], blue[i] = scene.background[2];
            transmittance[i] = inside ? 1.0f : 0.0f;
            if (WITH_DEPTH) depth[i] = 0.0f, alpha[i] = 0.0f;
        }
        find_active();
    }

    INLINE_MEMBER void find_active() {
        active = 0;
#pragma unroll
        for (int i = 0; i < QUAD; ++i)
            active |= uint32_t(__any_sync(ALL_LANES, transmittance[i] > finished) != 0) << i;
    }

    // Blend one splat over a patch. Its share of a pixel is 0 once the transmittance has fallen to `finished`, or in an
    // exact image once it would; the transmittance itself keeps falling.
    INLINE_MEMBER void blend(const Record& record, int patch) {
        const float4 place = record.place, fall = record.fall, color = record.color;
        const float dx = (patch % 2 == 0 ? x : x + PATCH_WIDTH) - place.x;
        const float dy = (patch / 2 == 0 ? y : y + PATCH_HEIGHT) - place.y;
        const float before = transmittance[patch];
        const float share = before * alpha_at(dx, dy, place.z, place.w, fall.x, fall.y, fall.z, log2_invisible);
        transmittance[patch] = before - share;
        const float tested = finished > MIN_TRANSMITTANCE ? before : transmittance[patch];
        const float counted = tested > finished ? share : 0.0f;
        red[patch] += counted * color.x;
        green[patch] += counted * color.y;
        blue[patch] += counted * color.z;
        if (WITH_DEPTH) depth[patch] += counted * fall.w, alpha[patch] += counted;
    }

    // Blend a slab, nearest first. Each warp picks what shows on its own patches, 32 splats at a time.
    INLINE_MEMBER void blend_slab(const Shared& shared, uint32_t count) {
        if (active == 0) return;
        for (uint32_t first = 0; first < count; first += WARP) {
            const uint32_t at = first + lane();
            const uint32_t patches = at < count ? shared.patches[at] >> (warp() * QUAD) & active : 0;
            const Record* records = shared.records + first;
            blended += __popc(patches);
#pragma unroll
            for (int i = 0; i < QUAD; ++i) {
                uint32_t left = __ballot_sync(ALL_LANES, patches >> i & 1);
                for (; left != 0; left &= left - 1) blend(records[__ffs(left) - 1], i);
            }
        }
        find_active();
    }

    INLINE_MEMBER void write(const Tile& tile, const Images& images, int row_of_batch, int width, int height) const {
#pragma unroll
        for (int i = 0; i < QUAD; ++i) {
            const int column = int(x) + i % 2 * PATCH_WIDTH, row = int(y) + i / 2 * PATCH_HEIGHT;
            if (column >= tile.right || row >= tile.bottom) continue;
            const size_t at = (size_t(row_of_batch) * height + row) * width + column;
            const float sums[3] = {red[i], green[i], blue[i]};
            for (int channel = 0; channel < 3; ++channel) {
                const float value = min(max(sums[channel], 0.0f), 1.0f);
                if (images.pixels) images.pixels[3 * at + channel] = uint8_t(int(255.0f * value + 0.5f));
                if (WITH_DEPTH) images.rgb[3 * at + channel] = value;
            }
            if (!WITH_DEPTH) continue;
            images.depth[at] = alpha[i] > 0.0f ? depth[i] / alpha[i] : 0.0f;
            images.alpha[at] = min(alpha[i], 1.0f);
        }
    }
};

}  // namespace splatrl
