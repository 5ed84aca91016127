#include "frame.h"

#include <algorithm>

namespace splatrl {

void write_images(const float* blocks, int width, const Tile& tile, const Images& images) {
    constexpr int AREA = BLOCK * BLOCK;
    for (int row = tile.top; row < tile.bottom; ++row)
        for (int column = tile.left; column < tile.right; ++column) {
            const int y = row - tile.top, x = column - tile.left;
            const float* lane =
                blocks + (y / BLOCK * ACROSS + x / BLOCK) * CHANNELS * AREA + y % BLOCK * BLOCK + x % BLOCK;
            const size_t pixel = size_t(row) * width + column;
            for (int channel = 0; channel < 3; ++channel) {
                const float value = std::min(std::max(lane[channel * AREA], 0.0f), 1.0f);
                if (images.rgb) images.rgb[3 * pixel + channel] = value;
                if (images.pixels) images.pixels[3 * pixel + channel] = uint8_t(255.0f * value + 0.5f);
            }
            if (!images.depth) continue;
            const float alpha = lane[ALPHA * AREA];
            images.alpha[pixel] = std::min(alpha, 1.0f);
            images.depth[pixel] = alpha > 0.0f ? lane[DEPTH * AREA] / alpha : 0.0f;
        }
}

}  // namespace splatrl
