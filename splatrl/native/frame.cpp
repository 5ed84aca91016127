#include "frame.h"

#include <algorithm>

namespace splatrl {

namespace {

constexpr int AREA = BLOCK * BLOCK;

// Copy the part of a block that lies within the image, from planar channels [COUNT, AREA] to interleaved pixels.
template <int COUNT, class T>
void copy_block(const T* values, T* image, int width, int columns, int rows) {
    for (int row = 0; row < rows; ++row)
        for (int column = 0; column < columns; ++column)
            for (int channel = 0; channel < COUNT; ++channel)
                image[(size_t(row) * width + column) * COUNT + channel] = values[channel * AREA + row * BLOCK + column];
}

}  // namespace

void write_images(const float* blocks, int width, const Tile& tile, const Images& images) {
    for (int block = 0; block < BLOCKS; ++block) {
        const int left = tile.left + block % ACROSS * BLOCK, top = tile.top + block / ACROSS * BLOCK;
        const int columns = std::min(BLOCK, tile.right - left), rows = std::min(BLOCK, tile.bottom - top);
        if (columns <= 0 || rows <= 0) continue;
        const float* channels = blocks + block * CHANNELS * AREA;
        const size_t corner = size_t(top) * width + left;
        float rgb[3 * AREA];
        for (int i = 0; i < 3 * AREA; ++i) rgb[i] = std::min(std::max(channels[i], 0.0f), 1.0f);
        if (images.rgb) copy_block<3>(rgb, images.rgb + 3 * corner, width, columns, rows);
        if (images.pixels) {
            uint8_t bytes[3 * AREA];
            for (int i = 0; i < 3 * AREA; ++i) bytes[i] = uint8_t(int(255.0f * rgb[i] + 0.5f));
            copy_block<3>(bytes, images.pixels + 3 * corner, width, columns, rows);
        }
        if (!images.depth) continue;
        float depth[AREA], alpha[AREA];
        for (int i = 0; i < AREA; ++i) {
            const float sum = channels[ALPHA * AREA + i];
            alpha[i] = std::min(sum, 1.0f);
            depth[i] = sum > 0.0f ? channels[DEPTH * AREA + i] / sum : 0.0f;
        }
        copy_block<1>(alpha, images.alpha + corner, width, columns, rows);
        copy_block<1>(depth, images.depth + corner, width, columns, rows);
    }
}

}  // namespace splatrl
