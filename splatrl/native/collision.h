// Bodies against a grid of solid voxels: at a pose, and on the way between two.
//
// Lengths are in voxels and positions count from the corner of the grid; the voxel (x, y, z) is the closed box from there
// to (x + 1, y + 1, z + 1). A touch is a hit. What lies outside the grid is free. Arithmetic is in double precision.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "buffer.h"

namespace splatrl {

using Vec3 = std::array<double, 3>;
using Mat3 = std::array<Vec3, 3>;  // rows

struct Grid {
    int size[3];
    double resolution, inverse;   // metres, 1 / metres
    Vec3 corner;                  // of the grid in the world, metres
    size_t solid;                 // voxels
    int words;                    // of a column
    std::vector<uint64_t> bits;  // [x, y, words]: bit z of a column is the voxel (x, y, z)
    // [x, y, z] from the centre of each voxel to that of the nearest solid one, in DISTANCE_STEPS a voxel, rounded down;
    // what is further than FARTHEST is that.
    Buffer<uint16_t> distance;
};

constexpr double DISTANCE_STEPS = 256.0;
constexpr uint16_t FARTHEST = 0xffff;

// A box (half extents), a sphere, or a capsule along its z (half length of the cylinder).
struct Shape {
    enum Kind { BOX, SPHERE, CAPSULE } kind;
    Vec3 half;
    double half_length, radius;
    double inner, outer;  // radii of the largest ball about the origin within, and of the smallest around

    Shape(Kind kind, const Vec3& half, double half_length, double radius);
    Shape grown(double by) const;
};

struct Pose {
    Mat3 rotation;  // body_to_world
    Vec3 position;  // voxels
};

// Whether a row-major 4×4 matrix is a pose: finite, a rotation, rigid.
bool is_pose(const float* matrix);

// From such a matrix in metres.
Vec3 position_of(const float* matrix, const Grid& grid);
Pose pose_of(const float* matrix, const Grid& grid);

// What the distance field alone says of a pose; MAYBE is for `touches` to decide.
enum class Verdict { FREE, HIT, MAYBE };
Verdict judge(const Grid& grid, const Shape& shape, const Vec3& position);
bool touches(const Grid& grid, const Shape& shape, const Pose& pose);

// Whether the distance field alone says that a move touches nothing.
bool passes(const Grid& grid, const Shape& shape, const Vec3& start, const Vec3& end);

// The share of a straight move, turning evenly about one axis, that is free: 1 where nothing is touched, ends included.
// Exact at a fixed orientation (a capsule within 1e-6 voxels). A turn is cut into parts; in each the orientation is that
// of its middle and the body is grown by what its points may be off, at most TURN_SLACK: never too far.
// With `any`, what is returned below 1 says only that something is touched.
double touched_fraction(const Grid& grid, const Shape& shape, const Pose& start, const Pose& end, bool any);

constexpr double TURN_SLACK = 0.1;  // voxels

// Have the distance at a point fetched: grids are larger than caches, and poses come in no order.
void fetch(const Grid& grid, const Vec3& point);

// A lower bound of the distance from a point to the nearest solid voxel, voxels.
double clearance(const Grid& grid, const Vec3& point);

}  // namespace splatrl
