// Lanes from and to memory: half floats, and records of the lanes that a mask selects, one after another.
#pragma once

#include "half.h"
#include "kernel.h"
#include "lanes.h"
#include "quads.h"

namespace splatrl {
namespace SPLATRL_ISA {

LANE_INLINE IntLanes int_lanes(int32_t value) {
    IntLanes out;
    FOR_PARTS out.part[p] = value - IntPart{};
    return out;
}

LANE_INLINE IntLanes load_ints(const uint32_t* from) {
    IntLanes out;
    std::memcpy(&out, __builtin_assume_aligned(from, 64), sizeof(out));
    return out;
}

LANE_INLINE IntLanes plus(const IntLanes& a, uint32_t b) {
    IntLanes out;
    FOR_PARTS out.part[p] = a.part[p] + int32_t(b);
    return out;
}

// Truncate to integers, for |a| < 2^31.
LANE_INLINE IntLanes to_ints(const Lanes& a) {
    IntLanes out;
    FOR_PARTS out.part[p] = __builtin_convertvector(a.part[p], IntPart);
    return out;
}

LANE_INLINE IntLanes bits_of(const Lanes& a) {
    IntLanes out;
    std::memcpy(&out, &a, sizeof(out));
    return out;
}

LANE_INLINE Lanes from_bits(const IntLanes& a) {
    Lanes out;
    std::memcpy(&out, &a, sizeof(out));
    return out;
}

// low | high << 16, for values of 16 bits.
LANE_INLINE IntLanes join_halves(const IntLanes& low, const IntLanes& high) {
    IntLanes out;
    FOR_PARTS out.part[p] = low.part[p] | (high.part[p] << 16);
    return out;
}

// Load sixteen 16-bit numbers, aligned to 32 bytes, and widen each to a word.
LANE_INLINE IntLanes load_shorts(const uint16_t* from) {
    typedef uint16_t ShortPart __attribute__((vector_size(2 * SPLATRL_REGISTER)));
    IntLanes out;
    FOR_PARTS {
        ShortPart part;
        std::memcpy(&part, from + p * SPLATRL_REGISTER, sizeof(part));
        out.part[p] = __builtin_convertvector(part, IntPart);
    }
    return out;
}

// Convert half floats, in the low halves of words, to floats.
LANE_INLINE Lanes from_halves(const IntLanes& halves) {
    Lanes out;
    FOR_PARTS {
        const IntPart magnitude = (halves.part[p] & 0x7fff) << 13, sign = (halves.part[p] & 0x8000) << 16;
        const FloatPart scaled = (FloatPart)magnitude * HALF_BIAS;
        out.part[p] = (FloatPart)((IntPart)scaled | sign);
    }
    return out;
}

LANE_INLINE Lanes load_halves(const uint16_t* from) {
#if defined(SPLATRL_AVX512)
    Lanes out;
    out.part[0] = (FloatPart)_mm512_maskz_cvtph_ps(0xffff, _mm256_load_si256(reinterpret_cast<const __m256i*>(from)));
    return out;
#elif defined(SPLATRL_AVX2)
    Lanes out;
    FOR_PARTS out.part[p] =
        (FloatPart)_mm256_cvtph_ps(_mm_loadu_si128(reinterpret_cast<const __m128i*>(from + p * SPLATRL_REGISTER)));
    return out;
#elif defined(__aarch64__)
    Lanes out;
    FOR_PARTS out.part[p] =
        (FloatPart)vcvt_f32_f16(vreinterpret_f16_u16(vld1_u16(from + p * SPLATRL_REGISTER)));
    return out;
#else
    return from_halves(load_shorts(from));
#endif
}

// Convert floats to half floats, in the low halves of words, rounded to nearest; values out of range become the largest
// finite one, with their sign.
LANE_INLINE IntLanes to_halves(const Lanes& a) {
    const Lanes bounded = max(min(a, LARGEST_HALF), -LARGEST_HALF);
    IntLanes out;
#if defined(SPLATRL_AVX512)
    const __m256i halves = _mm512_maskz_cvtps_ph(0xffff, (__m512)bounded.part[0], _MM_FROUND_TO_NEAREST_INT);
    out.part[0] = (IntPart)_mm512_maskz_cvtepu16_epi32(0xffff, halves);
#elif defined(__aarch64__)
    FOR_PARTS out.part[p] =
        (IntPart)vmovl_u16(vreinterpret_u16_f16(vcvt_f16_f32((float32x4_t)bounded.part[p])));
#else
    FOR_PARTS {
        const IntPart sign = ((IntPart)bounded.part[p] >> 16) & 0x8000;
        const FloatPart magnitude = (FloatPart)((IntPart)bounded.part[p] & 0x7fffffff);
        const IntPart bits = (IntPart)(magnitude * INVERSE_HALF_BIAS);
        out.part[p] = ((bits + 0xfff + ((bits >> 13) & 1)) >> 13) | sign;
    }
#endif
    return out;
}

// Convert four half floats to floats; `to` is aligned to 16 bytes.
LANE_INLINE void store_four_halves(float* to, const uint16_t* from) {
#if defined(SPLATRL_AVX512) || defined(SPLATRL_AVX2)
    _mm_store_ps(to, _mm_cvtph_ps(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(from))));
#elif defined(__aarch64__)
    vst1q_f32(to, vcvt_f32_f16(vreinterpret_f16_u16(vld1_u16(from))));
#else
    for (int i = 0; i < 4; ++i) to[i] = from_half(from[i]);
#endif
}

#if defined(SPLATRL_AVX512)

LANE_INLINE __m512 kept(const Lanes& value, __m512i lanes_kept) {
    return _mm512_maskz_permutexvar_ps(0xffff, lanes_kept, (__m512)value.part[0]);
}

LANE_INLINE void append_words(void* to, __m512i low, __m512i high) {
    const __m512i first = _mm512_set_epi32(23, 7, 22, 6, 21, 5, 20, 4, 19, 3, 18, 2, 17, 1, 16, 0);
    const __m512i second = _mm512_set_epi32(31, 15, 30, 14, 29, 13, 28, 12, 27, 11, 26, 10, 25, 9, 24, 8);
    _mm512_storeu_si512(to, _mm512_permutex2var_epi32(low, first, high));
    _mm512_storeu_si512(static_cast<char*>(to) + 64, _mm512_permutex2var_epi32(low, second, high));
}

#else

// rows[lane][column] = columns[column][lane], in blocks of 4×4.
template <int COLUMNS>
LANE_INLINE void transpose(const Lanes (&columns)[COLUMNS], float (*rows)[COLUMNS]) {
    static_assert(COLUMNS % 4 == 0, "whole quads");
    for (int column = 0; column < COLUMNS; column += 4)
        for (int lane = 0; lane < LANES; lane += 4) {
            Quad quads[4];
            for (int i = 0; i < 4; ++i)
                std::memcpy(&quads[i], reinterpret_cast<const float*>(&columns[column + i]) + lane, sizeof(Quad));
            turn_quads(quads);
            for (int i = 0; i < 4; ++i) std::memcpy(&rows[lane + i][column], &quads[i], sizeof(Quad));
        }
}

#endif

// What is appended for each visible lane. `words` are those of a Splat.
struct Record {
    Lanes words[8];
    Lanes depth;
    IntLanes rest, original_index;  // tie-breakers for equal depths
    Lanes peak;
    bool merging;  // whether peaks are kept
    bool ranked;   // whether the tie-breakers are kept
};

// Write the lanes of the mask, in order, from position `count` on, and return the new count. Up to SPARE places after
// it are overwritten too.
LANE_INLINE uint32_t append(const Record& record, uint32_t mask, const Scratch& scratch, uint32_t count) {
#if defined(SPLATRL_AVX512)
    const __m512i ordinals = _mm512_set_epi32(15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0);
    const __m512i kept_lanes = _mm512_maskz_compress_epi32(__mmask16(mask), ordinals);
    __m512 pairs[8];  // pairs[half + i]: words half to half + 3 of lane 4q + i in quarter q
    for (int half = 0; half < 8; half += 4) {
        const __m512 a = kept(record.words[half], kept_lanes), b = kept(record.words[half + 1], kept_lanes);
        const __m512 c = kept(record.words[half + 2], kept_lanes), d = kept(record.words[half + 3], kept_lanes);
        const __m512d low_ab = _mm512_castps_pd(_mm512_unpacklo_ps(a, b)),
            low_cd = _mm512_castps_pd(_mm512_unpacklo_ps(c, d));
        const __m512d high_ab = _mm512_castps_pd(_mm512_unpackhi_ps(a, b)),
            high_cd = _mm512_castps_pd(_mm512_unpackhi_ps(c, d));
        pairs[half] = _mm512_castpd_ps(_mm512_unpacklo_pd(low_ab, low_cd));
        pairs[half + 1] = _mm512_castpd_ps(_mm512_unpackhi_pd(low_ab, low_cd));
        pairs[half + 2] = _mm512_castpd_ps(_mm512_unpacklo_pd(high_ab, high_cd));
        pairs[half + 3] = _mm512_castpd_ps(_mm512_unpackhi_pd(high_ab, high_cd));
    }
    const __m512i near_half = _mm512_set_epi64(11, 10, 3, 2, 9, 8, 1, 0),
        far_half = _mm512_set_epi64(15, 14, 7, 6, 13, 12, 5, 4);
    for (int i = 0; i < 4; ++i) {
        const __m512d front = _mm512_castps_pd(pairs[i]), back = _mm512_castps_pd(pairs[i + 4]);
        const __m512d low = _mm512_permutex2var_pd(front, near_half, back),
            high = _mm512_permutex2var_pd(front, far_half, back);
        float* to = reinterpret_cast<float*>(scratch.splats + count + i);
        _mm256_store_ps(to, _mm256_castpd_ps(_mm512_castpd512_pd256(low)));
        _mm256_store_ps(to + 32, _mm256_castpd_ps(_mm512_extractf64x4_pd(low, 1)));
        _mm256_store_ps(to + 64, _mm256_castpd_ps(_mm512_castpd512_pd256(high)));
        _mm256_store_ps(to + 96, _mm256_castpd_ps(_mm512_extractf64x4_pd(high, 1)));
    }
    if (record.merging) _mm512_storeu_ps(scratch.peaks + count, kept(record.peak, kept_lanes));
    const __m512 depth = kept(record.depth, kept_lanes);
    append_words(scratch.keys + count, _mm512_add_epi32(ordinals, _mm512_set1_epi32(int32_t(count))),
                 _mm512_castps_si512(depth));
    if (record.ranked)
        append_words(scratch.ties + count, _mm512_castps_si512(kept(from_bits(record.original_index), kept_lanes)),
                     _mm512_castps_si512(kept(from_bits(record.rest), kept_lanes)));
    return count + uint32_t(__builtin_popcount(mask));
#else
    alignas(64) float rows[LANES][8], depths[LANES], peaks[LANES];
    alignas(64) uint32_t rests[LANES], indices[LANES];
    transpose(record.words, rows);
    store(depths, record.depth);
    store(peaks, record.peak);
    std::memcpy(rests, &record.rest, sizeof(rests));
    std::memcpy(indices, &record.original_index, sizeof(indices));
    for (uint32_t lane = 0; lane < uint32_t(LANES); ++lane) {  // the next lane overwrites one that is not kept
        std::memcpy(&scratch.splats[count], rows[lane], sizeof(Splat));
        if (record.merging) scratch.peaks[count] = peaks[lane];
        if (record.ranked) scratch.ties[count] = uint64_t(rests[lane]) << 32 | indices[lane];
        uint32_t depth_bits;
        std::memcpy(&depth_bits, &depths[lane], sizeof(depth_bits));
        scratch.keys[count] = uint64_t(depth_bits) << 32 | count;
        count += mask >> lane & 1;
    }
    return count;
#endif
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
