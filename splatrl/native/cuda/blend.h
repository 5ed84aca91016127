// Blends sorted keys into pixels. A quarter of a warp has four cells of 4×2 pixels in different places of the tile, and
// goes through the splats of one cell after the other. Narrow splats thus leave few lanes idle, and no warp has much
// more to do than the others, which would have to wait for it.
#pragma once

#include "order.h"
#include "tile.h"

namespace splatrl {

constexpr uint32_t FIRST = 1u << 31;  // the bit that stands for the first of 32 splats or chunks

constexpr float NOTHING = -1e30f;     // log2 of an opacity that is invisible

// Clear the highest bit of a word that is not 0, and return its place: 0 for the lowest bit of all.
SPLAT_INLINE int take_highest(uint32_t& bits) {
    const int place = 31 - __clz(bits);
    bits ^= 1u << place;
    return place;
}

// Evaluate a splat's colour, seen along `offset` and relative to the background, and store it as half floats in the
// record, together with the splat's peak.
SPLAT_INLINE void add_color(const SceneArrays& scene, uint32_t at, const Vector<float>& offset, float peak,
                            Record& record) {
    constexpr int HARMONICS = harmonics_of(SH_DEGREE), WORDS = color_stride(SH_DEGREE) / 8;
    const uint4* words = scene.colors + size_t(at) * WORDS;
    if (SH_DEGREE == 0) {
        const uint2 three = *reinterpret_cast<const uint2*>(words);
        record.peak_red = halves_of(peak, 0.0f) | three.x << 16;
        record.green_blue = three.x >> 16 | three.y << 16;
        return;
    }
    const float squared = offset.x * offset.x + offset.y * offset.y + offset.z * offset.z;
    const float inverse = reciprocal_sqrt(max(squared, 1e-30f));
    float basis[16], sums[3] = {0.5f, 0.5f, 0.5f};
    sh_basis(SH_DEGREE, offset.x * inverse, offset.y * inverse, offset.z * inverse, basis);
#pragma unroll
    for (int word = 0; word < WORDS; ++word) {
        const uint4 eight = words[word];
        const uint32_t pairs[4] = {eight.x, eight.y, eight.z, eight.w};
#pragma unroll
        for (int i = 0; i < 8; ++i) {
            const int harmonic = (8 * word + i) / 3, channel = (8 * word + i) % 3;
            const float coefficient = i % 2 == 0 ? low_half(pairs[i / 2]) : high_half(pairs[i / 2]);
            if (harmonic < HARMONICS) sums[channel] += basis[harmonic] * coefficient;
        }
    }
    float out[3];
    for (int i = 0; i < 3; ++i) out[i] = max(sums[i], 0.0f) - scene.background[i];
    record.peak_red = halves_of(peak, out[0]);
    record.green_blue = halves_of(out[1], out[2]);
}

// Prefetch the colour of a Gaussian, which may straddle two cache lines.
SPLAT_INLINE void prefetch_color(const SceneArrays& scene, uint32_t at) {
    constexpr int WORDS = color_stride(SH_DEGREE) / 8;
    if (SH_DEGREE == 0) return;
    const uint4* words = scene.colors + size_t(at) * WORDS;
    prefetch_to_own_cache(words), prefetch_to_own_cache(words + WORDS - 1);
}

// The part that an index of the row belongs to.
SPLAT_INLINE int part_of(const Views& views, const Shared& shared, uint32_t index) {
    return WITH_PARTS ? behind_last(shared.bases, 0, views.parts, index) - 1 : 0;
}

// Position in shapes and colours of the Gaussian with this index in the row.
SPLAT_INLINE uint32_t location_of(const Views& views, const Shared& shared, int part, uint32_t index) {
    return WITH_PARTS ? index + place_of(views, shared.row, part).shift : index;
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

// A Gaussian of a slab, as the row's camera sees it, in the frame of its part.
struct Seen {
    Camera camera;
    uint32_t at;           // position in shapes and colours
    float4 mean;           // with the log2 opacity in w
    Vector<float> offset;  // mean relative to the camera

    INLINE_MEMBER Seen(const SceneArrays& scene, const Views& views, const Shared& shared, uint32_t index) {
        const int part = part_of(views, shared, index);
        camera = camera_of_part(views, shared, part);
        at = location_of(views, shared, part, index);
        mean = scene.shapes[3 * size_t(at)];
        offset = {mean.x - camera.position[0], mean.y - camera.position[1], mean.z - camera.position[2]};
    }

    INLINE_MEMBER Footprint<float> footprint(const SceneArrays& scene, float log2_invisible) const {
        const float4 a = scene.shapes[3 * size_t(at) + 1], b = scene.shapes[3 * size_t(at) + 2];
        const float factor[6] = {a.x, a.y, a.z, a.w, b.x, b.y};
        return project<ANTIALIASED_IMAGE, WITH_LEVELS>(camera, offset, factor, mean.w, Merging<float>{b.z, b.w},
                                                       log2_invisible);
    }
};

// Project the Gaussians of a sorted slab and keep, in their order, those that may be visible. Returns how many.
template <bool WITH_DEPTH>
SPLAT_INLINE uint32_t project_slab(const SceneArrays& scene, const Views& views,
                                   typename SharedFor<WITH_DEPTH>::Type& shared, uint32_t count, float log2_invisible) {
    uint32_t kept = 0;
    for (uint32_t begin = 0; begin < count; begin += THREADS) {
        const uint32_t i = begin + thread();
        const uint32_t index = i < count ? index_of(shared.sorted[i]) : 0;
        Footprint<float> print{};
        bool shows = false;
        if (i < count) {
            PASS(project);
            print = Seen(scene, views, shared, index).footprint(scene, log2_invisible);
            shows = may_show(print, shared.tile, log2_invisible);
        }
        const uint32_t lanes = __ballot_sync(ALL_LANES, shows);
        if (lane() == 0) shared.sums[warp()] = __popc(lanes);
        __syncthreads();
        uint32_t place = kept + rank_in(lanes);
        for (int other = 0; other < WARPS; ++other) {
            if (other < warp()) place += shared.sums[other];
            kept += shared.sums[other];
        }
        if (shows) {
            if (!WITH_PARTS) prefetch_color(scene, index);
            shared.records[place] = {print.x, print.y, print.l11, print.l12, print.l22, print.log2_opacity,
                                     __float_as_uint(print.peak), index};
            if constexpr (WITH_DEPTH) shared.depths[place] = print.depth;
        }
        __syncthreads();
    }
    return kept;
}

// Evaluate the colours of the splats that project_slab kept, and record in bit masks on which cells each may be
// visible. A warp takes a chunk of splats.
SPLAT_INLINE void color_slab(const SceneArrays& scene, const Views& views, Shared& shared, uint32_t count,
                             float log2_invisible) {
    if (thread() < CELLS) shared.chunks[thread()] = 0;
    __syncthreads();
    for (uint32_t first = warp() * WARP; first < count; first += THREADS) {
        const uint32_t chunk = first / WARP, i = first + lane();
        uint32_t* cells = shared.cells[chunk];
        for (int cell = lane(); cell < CELLS; cell += WARP) cells[cell] = 0;
        __syncwarp();
        if (i < count) {
            PASS(color);
            Record record = shared.records[i];
            const Seen seen(scene, views, shared, record.green_blue);
            add_color(scene, seen.at, seen.offset, __uint_as_float(record.peak_red), record);
            shared.records[i].peak_red = record.peak_red, shared.records[i].green_blue = record.green_blue;
            const Ellipse ellipse(record.x - float(shared.tile.left), record.y - float(shared.tile.top), record.l11,
                                  record.l12, record.l22, record.log2_opacity - log2_invisible);
            for_each_cell(ellipse, [&](int cell) { atomicOr(&cells[cell], FIRST >> lane()); });
        }
        __syncwarp();
        for (int cell = lane(); cell < CELLS; cell += WARP)
            if (cells[cell] != 0) atomicOr(&shared.chunks[cell], FIRST >> chunk);
    }
    __syncthreads();
}

// The pixels of a thread: one in each cell of its quarter-warp.
template <bool WITH_DEPTH>
struct Pixels {
    using SharedMemory = typename SharedFor<WITH_DEPTH>::Type;

    float finished;         // transmittance at or below which a pixel is finished
    float log2_invisible;
    int left, top;          // corner of the tile, plus the pixel's position in its cell
    uint32_t open;          // bit mask of the bands in which the pixel is not finished
    uint32_t active;        // bit mask of the bands in which the cell is not finished
    uint32_t blended;       // number of splats blended over the cells

    INLINE_MEMBER void begin(const SceneArrays& scene, SharedMemory& shared) {
        finished = finished_at(scene.tolerance);
        log2_invisible = log2_invisible_at(scene.tolerance, ANTIALIASED_IMAGE);
        left = shared.tile.left + thread() % CELL_WIDTH, top = shared.tile.top + thread() % QUARTER / CELL_WIDTH;
        open = blended = 0;
        for (int band = 0; band < BANDS; ++band) {
            const bool seen = column_in(band) < shared.tile.right && row_in(band) < shared.tile.bottom;
            open |= uint32_t(seen) << band;
            shared.pixels[band][thread()] = {scene.background[0], scene.background[1], scene.background[2],
                                             seen ? 1.0f : 0.0f};
            if constexpr (WITH_DEPTH) shared.behind[band][thread()] = {0.0f, 0.0f};
        }
        find_active();
    }

    static INLINE_MEMBER int quarter() { return thread() / QUARTER; }
    INLINE_MEMBER int column_in(int band) const { return left + column_of(quarter(), band) * CELL_WIDTH; }
    INLINE_MEMBER int row_in(int band) const { return top + row_of(quarter(), band) * CELL_HEIGHT; }

    INLINE_MEMBER void find_active() {
        active = 0;
        for (int band = 0; band < BANDS; ++band) {
            const uint32_t lanes = __ballot_sync(ALL_LANES, open >> band & 1);
            active |= uint32_t((lanes >> lane() / QUARTER * QUARTER & ((1u << QUARTER) - 1)) != 0) << band;
        }
    }

    // The opacity of a splat at a pixel, if its log2 opacity were this one.
    INLINE_MEMBER float alpha_of(const Record& record, float x, float y, float log2_opacity) const {
        return alpha_at(x - record.x, y - record.y, record.l11, record.l12, record.l22, log2_opacity,
                        low_half(record.peak_red), log2_invisible);
    }

    // Blend one splat over a pixel, and return its blending weight. The weight is 0 once the transmittance has fallen
    // to `finished`, or in an exact image once the splat would lower it that far; the transmittance itself keeps
    // falling. (On a CPU, images with a tolerance below 0.1 pixels count as exact in this: less than 0.03 grey levels.)
    INLINE_MEMBER float blend(const Record& record, float alpha, Pixel& pixel) const {
        const float before = pixel.transmittance, share = before * alpha;
        pixel.transmittance = before - share;
        const float counted = (WITH_LEVELS ? before : pixel.transmittance) > finished ? share : 0.0f;
        pixel.red += counted * high_half(record.peak_red);
        pixel.green += counted * low_half(record.green_blue);
        pixel.blue += counted * high_half(record.green_blue);
        return counted;
    }

    // Blend a slab, nearest first. A quarter of a warp goes through the chunks that have splats on a cell, through
    // those splats by their bits, and then takes its next cell: quarters do not wait for each other. Two splats are
    // evaluated together, since neither has to wait for the other.
    INLINE_MEMBER void blend_slab(SharedMemory& shared) {
        const int first = quarter() * BANDS;  // number of the first of its cells
        uint32_t chunks = 0, splats = 0;
        int band = -1, last = 0;  // last: the last splat of the chunk
        float x = 0.0f, y = 0.0f;
        Pixel pixel{};
        Behind behind{};
        for (;;) {
            if (splats == 0) {
                if (chunks == 0) {
                    if (band >= 0) put(shared, band, pixel, behind);
                    while (++band < BANDS && (chunks = active >> band & 1 ? shared.chunks[first + band] : 0) == 0)
                        ;
                    if (band == BANDS) break;
                    pixel = shared.pixels[band][thread()];
                    if constexpr (WITH_DEPTH) behind = shared.behind[band][thread()];
                    x = float(column_in(band)) + 0.5f, y = float(row_in(band)) + 0.5f;
                }
                PASS(chunk);
                const int chunk = WARP - 1 - take_highest(chunks);
                splats = shared.cells[chunk][first + band], last = chunk * WARP + WARP - 1;
                blended += __popc(splats);
            }
            PASS(pair);
            const int one_bit = take_highest(splats);
            const bool another = splats != 0;
            splats = another ? splats : 1;  // so that nothing branches
            const int next_bit = take_highest(splats), two_bit = another ? next_bit : one_bit;
            const Record &one = shared.records[last - one_bit], &two = shared.records[last - two_bit];
            const float alpha_of_one = alpha_of(one, x, y, one.log2_opacity);
            const float alpha_of_two = alpha_of(two, x, y, another ? two.log2_opacity : NOTHING);
            const float share_of_one = blend(one, alpha_of_one, pixel);
            const float share_of_two = blend(two, alpha_of_two, pixel);
            if constexpr (WITH_DEPTH) {
                behind.depth += share_of_one * shared.depths[last - one_bit], behind.alpha += share_of_one;
                behind.depth += share_of_two * shared.depths[last - two_bit], behind.alpha += share_of_two;
            }
        }
        __syncwarp();
        find_active();
    }

    INLINE_MEMBER void put(SharedMemory& shared, int band, const Pixel& pixel, const Behind& behind) {
        shared.pixels[band][thread()] = pixel;
        if constexpr (WITH_DEPTH) shared.behind[band][thread()] = behind;
        if (!(pixel.transmittance > finished)) open &= ~(1u << band);
    }

    INLINE_MEMBER void write(const SharedMemory& shared, const Images& images, int width, int height) const {
        for (int band = 0; band < BANDS; ++band) {
            const int across = column_in(band), down = row_in(band);
            if (across >= shared.tile.right || down >= shared.tile.bottom) continue;
            const size_t at = (size_t(shared.row) * height + down) * width + across;
            const Pixel pixel = shared.pixels[band][thread()];
            const float sums[3] = {pixel.red, pixel.green, pixel.blue};
            for (int channel = 0; channel < 3; ++channel) {
                const float value = min(max(sums[channel], 0.0f), 1.0f);
                if (images.pixels) images.pixels[3 * at + channel] = uint8_t(int(255.0f * value + 0.5f));
                if (WITH_DEPTH) images.rgb[3 * at + channel] = value;
            }
            if constexpr (WITH_DEPTH) {
                const Behind behind = shared.behind[band][thread()];
                images.depth[at] = behind.alpha > 0.0f ? behind.depth / behind.alpha : 0.0f;
                images.alpha[at] = min(behind.alpha, 1.0f);
            }
        }
    }
};

}  // namespace splatrl
