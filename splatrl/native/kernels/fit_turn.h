// Transposes a matrix of 16×16 floats.
#pragma once

#include <cstring>

#include "lanes.h"
#include "quads.h"

namespace splatrl {
namespace SPLATRL_ISA {

// out[column][row] = in[row][column]; both are aligned to 64 bytes and must not overlap.
LANE_INLINE void turn(const float* in, float* out) {
#if defined(SPLATRL_AVX512)
    __m512 a[16], b[16];
    for (int i = 0; i < 16; ++i) a[i] = _mm512_load_ps(in + 16 * i);
    for (int i = 0; i < 8; ++i) {
        b[2 * i] = _mm512_unpacklo_ps(a[2 * i], a[2 * i + 1]);
        b[2 * i + 1] = _mm512_unpackhi_ps(a[2 * i], a[2 * i + 1]);
    }
    for (int i = 0; i < 4; ++i) {
        const __m512d p = _mm512_castps_pd(b[4 * i]), q = _mm512_castps_pd(b[4 * i + 2]);
        const __m512d r = _mm512_castps_pd(b[4 * i + 1]), s = _mm512_castps_pd(b[4 * i + 3]);
        a[4 * i] = _mm512_castpd_ps(_mm512_unpacklo_pd(p, q));
        a[4 * i + 1] = _mm512_castpd_ps(_mm512_unpackhi_pd(p, q));
        a[4 * i + 2] = _mm512_castpd_ps(_mm512_unpacklo_pd(r, s));
        a[4 * i + 3] = _mm512_castpd_ps(_mm512_unpackhi_pd(r, s));
    }
    for (int i = 0; i < 4; ++i) {
        const __m512 top = _mm512_shuffle_f32x4(a[i], a[4 + i], 0x88),
            low = _mm512_shuffle_f32x4(a[8 + i], a[12 + i], 0x88);
        const __m512 odd = _mm512_shuffle_f32x4(a[i], a[4 + i], 0xdd),
            end = _mm512_shuffle_f32x4(a[8 + i], a[12 + i], 0xdd);
        _mm512_store_ps(out + 16 * i, _mm512_shuffle_f32x4(top, low, 0x88));
        _mm512_store_ps(out + 16 * (8 + i), _mm512_shuffle_f32x4(top, low, 0xdd));
        _mm512_store_ps(out + 16 * (4 + i), _mm512_shuffle_f32x4(odd, end, 0x88));
        _mm512_store_ps(out + 16 * (12 + i), _mm512_shuffle_f32x4(odd, end, 0xdd));
    }
#else
    for (int row = 0; row < 16; row += 4)
        for (int column = 0; column < 16; column += 4) {
            Quad quads[4];
            for (int i = 0; i < 4; ++i) std::memcpy(&quads[i], in + 16 * (row + i) + column, sizeof(Quad));
            turn_quads(quads);
            for (int i = 0; i < 4; ++i) std::memcpy(out + 16 * (column + i) + row, &quads[i], sizeof(Quad));
        }
#endif
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
