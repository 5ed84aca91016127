#include "frame.h"

#include <algorithm>

namespace splatrl {

void write_images(const float* frame, const Camera& camera, const float background[3], const Images& images) {
    constexpr int AREA = BLOCK * BLOCK;
    const int across = (camera.width + BLOCK - 1) / BLOCK;
    for (int row = 0; row < camera.height; ++row)
        for (int column = 0; column < camera.width; ++column) {
            const size_t block = size_t(row / BLOCK) * across + column / BLOCK;
            const float* lane = frame + block * CHANNELS * AREA + row % BLOCK * BLOCK + column % BLOCK;
            const size_t pixel = size_t(row) * camera.width + column;
            const float alpha = std::min(lane[ALPHA * AREA], 1.0f);
            for (int channel = 0; channel < 3; ++channel) {
                const float blended = lane[channel * AREA] + (1.0f - alpha) * background[channel];
                const float value = std::min(std::max(blended, 0.0f), 1.0f);
                if (images.rgb) images.rgb[3 * pixel + channel] = value;
                if (images.pixels) images.pixels[3 * pixel + channel] = uint8_t(255.0f * value + 0.5f);
            }
            if (images.alpha) images.alpha[pixel] = alpha;
            if (images.depth) images.depth[pixel] = alpha > 0.0f ? lane[DEPTH * AREA] / lane[ALPHA * AREA] : 0.0f;
        }
}

}  // namespace splatrl
