// A pinhole camera as the renderers read it.
#pragma once

#include "inline.h"

namespace splatrl {

struct Camera {
    float rotation[9];  // world_to_camera, row-major
    float position[3];  // world, metres
    float fx, fy, cx, cy;
    float slope_left, slope_right, slope_top, slope_bottom;  // bounds of x / z and y / z in the Jacobian
    int width, height;
};

// A rectangle of an image, in pixels; the lower and right edges are exclusive.
struct Tile {
    int left, top, right, bottom;
};

// Whether K, row-major 3×3, describes a pinhole: finite, with positive focal lengths and no skew.
SPLAT_INLINE bool is_lens(const float* K) {
    const bool finite = 0.0f * K[0] + 0.0f * K[2] + 0.0f * K[4] + 0.0f * K[5] == 0.0f;
    return finite && K[0] > 0.0f && K[4] > 0.0f && K[1] == 0.0f && K[3] == 0.0f && K[6] == 0.0f && K[7] == 0.0f &&
           K[8] == 1.0f;
}

// Build a camera from camera_to_world, row-major 4×4, and K, row-major 3×3. The slopes in the Jacobian are bounded to a
// margin of 0.15 image sizes, beyond which the linearised projection would blow up.
SPLAT_INLINE Camera camera_of(const float* pose, const float* K, int width, int height) {
    Camera camera;
    for (int row = 0; row < 3; ++row)
        for (int column = 0; column < 3; ++column) camera.rotation[3 * row + column] = pose[4 * column + row];
    for (int axis = 0; axis < 3; ++axis) camera.position[axis] = pose[4 * axis + 3];
    camera.fx = K[0], camera.fy = K[4], camera.cx = K[2], camera.cy = K[5];
    const float margin_x = 0.15f * float(width) / camera.fx, margin_y = 0.15f * float(height) / camera.fy;
    camera.slope_left = -camera.cx / camera.fx - margin_x;
    camera.slope_right = (float(width) - camera.cx) / camera.fx + margin_x;
    camera.slope_top = -camera.cy / camera.fy - margin_y;
    camera.slope_bottom = (float(height) - camera.cy) / camera.fy + margin_y;
    camera.width = width, camera.height = height;
    return camera;
}

}  // namespace splatrl
