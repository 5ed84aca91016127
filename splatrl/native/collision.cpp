#include "collision.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>

#include "box_sweep.h"
#include "columns.h"
#include "contact.h"

namespace splatrl {

namespace {

constexpr double MARGIN = 1e-4;  // voxels: beyond single precision of the distance field
constexpr double HALF_DIAGONAL = 0.8660254037844387;

// Half the extents of the box around a shape, voxels.
Vec3 half_extents(const Shape& shape, const Mat3& rotation) {
    Vec3 out;
    for (int i = 0; i < 3; ++i) {
        out[i] = shape.radius;
        if (shape.kind == Shape::CAPSULE) out[i] += shape.half_length * std::fabs(rotation[i][2]);
        if (shape.kind == Shape::BOX)
            for (int k = 0; k < 3; ++k) out[i] += shape.half[k] * std::fabs(rotation[i][k]);
    }
    return out;
}

// The first t in [0, 1] at which a shape that goes along `way` without turning touches something, or NEVER.
double first_contact(const Grid& grid, const Shape& shape, const Pose& pose, const Vec3& way, bool any) {
    const Vec3 half = half_extents(shape, pose.rotation);
    Vec3 low, high;
    for (int i = 0; i < 3; ++i) {
        low[i] = pose.position[i] + std::min(way[i], 0.0) - half[i];
        high[i] = pose.position[i] + std::max(way[i], 0.0) + half[i];
    }
    double first = NEVER;
    if (shape.kind == Shape::BOX) {
        std::optional<BoxSweep> sweep;
        each_column(grid, low, high, [&](int x, int y, const uint64_t* column, Range zs) {
            if (!sweep) sweep.emplace(shape, pose, way);
            const Range within = sweep->column(x, y, zs);
            return any_solid(column, std::max(within.first, zs.first), std::min(within.last, zs.last), [&](int z) {
                first = std::min(first, any ? 0.0 : sweep->contact(x, y, z));
                return first == 0.0;
            });
        });
        return first;
    }
    Vec3 axis{};
    Vec3 bottom = pose.position;
    if (shape.kind == Shape::CAPSULE)
        for (int i = 0; i < 3; ++i) {
            axis[i] = 2.0 * shape.half_length * pose.rotation[i][2];
            bottom[i] -= 0.5 * axis[i];
        }
    each_column(grid, low, high, [&](int x, int y, const uint64_t* column, Range zs) {
        return any_solid(column, zs.first, zs.last, [&](int z) {
            const Vec3 corner{double(x), double(y), double(z)};
            const double t = shape.kind == Shape::SPHERE
                                 ? ball_contact(corner, bottom, way, shape.radius + SLACK)
                                 : capsule_contact(corner, bottom, axis, way, shape.radius + SLACK);
            first = std::min(first, any && t < NEVER ? 0.0 : t);
            return first == 0.0;
        });
    });
    return first;
}

typedef float Quad __attribute__((vector_size(16)));
typedef int QuadIndex __attribute__((vector_size(16)));

#if defined(__clang__)
Quad next_of(const Quad& a) { return __builtin_shufflevector(a, a, 1, 2, 0, 3); }        // y, z, x
Quad after_next_of(const Quad& a) { return __builtin_shufflevector(a, a, 2, 0, 1, 3); }  // z, x, y
#else
Quad next_of(const Quad& a) { return __builtin_shuffle(a, QuadIndex{1, 2, 0, 3}); }
Quad after_next_of(const Quad& a) { return __builtin_shuffle(a, QuadIndex{2, 0, 1, 3}); }
#endif

struct Nearby {
    double at_least, at_most;  // distance to the nearest solid voxel, and to the nearest centre of one
};

// Where a point is in the grid: the nearest point of the grid, and its voxel.
struct Place {
    Vec3 within;
    int index[3];
    size_t voxel;

    Place(const Grid& grid, const Vec3& point) {
        for (int i = 0; i < 3; ++i) {
            within[i] = std::min(std::max(point[i], 0.0), double(grid.size[i]));
            index[i] = std::min(int(within[i]), grid.size[i] - 1);
        }
        voxel = (size_t(index[0]) * grid.size[1] + index[1]) * grid.size[2] + index[2];
    }
};

Nearby nearby(const Grid& grid, const Vec3& point) {
    const Place place(grid, point);
    double outside = 0.0, to_center = 0.0;
    for (int i = 0; i < 3; ++i) {
        const double out = point[i] - place.within[i], off = place.within[i] - place.index[i] - 0.5;
        outside += out * out;
        to_center += off * off;
    }
    to_center = std::sqrt(to_center);
    const uint16_t steps = grid.distance[place.voxel];
    const double inside = std::max(steps / DISTANCE_STEPS - HALF_DIAGONAL - to_center, 0.0);
    if (outside > 0.0) return {std::sqrt(outside + inside * inside), NEVER};
    return {inside, steps == FARTHEST ? NEVER : (steps + 1) / DISTANCE_STEPS + to_center};
}

bool empty(const Grid& grid) { return grid.solid == 0; }

// Turn by an angle about a unit axis, times a rotation (Rodrigues).
Mat3 turned(const Vec3& axis, double angle, const Mat3& rotation) {
    const double c = std::cos(angle), s = std::sin(angle);
    Mat3 out{};
    for (int column = 0; column < 3; ++column) {
        const Vec3 v{rotation[0][column], rotation[1][column], rotation[2][column]};
        const Vec3 side = cross(axis, v);
        const double share = dot(axis, v) * (1.0 - c);
        for (int i = 0; i < 3; ++i) out[i][column] = v[i] * c + side[i] * s + axis[i] * share;
    }
    return out;
}

// The axis and angle in [0, π] of the turn from one orientation to another.
double turn_between(const Mat3& from, const Mat3& to, Vec3& axis) {
    Mat3 turn;  // to · fromᵀ
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) turn[i][k] = dot(to[i], from[k]);
    const Vec3 doubled{turn[2][1] - turn[1][2], turn[0][2] - turn[2][0], turn[1][0] - turn[0][1]};
    const double sine = 0.5 * norm(doubled), cosine = 0.5 * (turn[0][0] + turn[1][1] + turn[2][2] - 1.0);
    if (sine > 1e-6) {
        for (int i = 0; i < 3; ++i) axis[i] = 0.5 * doubled[i] / sine;
    } else {  // next to nothing, or half a turn: then turn + I is 2 axis axisᵀ
        int longest = 0;
        for (int i = 1; i < 3; ++i)
            if (turn[i][i] > turn[longest][longest]) longest = i;
        for (int i = 0; i < 3; ++i) axis[i] = turn[i][longest] + (i == longest ? 1.0 : 0.0);
        const double length = norm(axis);
        for (double& value : axis) value /= length;
    }
    return std::atan2(sine, cosine);
}

}  // namespace

Shape::Shape(Kind kind, const Vec3& half, double half_length, double radius)
    : kind(kind),
      half(half),
      half_length(half_length),
      radius(radius),
      inner(kind == BOX ? std::min({half[0], half[1], half[2]}) : radius),
      outer(kind == BOX ? norm(half) : radius + half_length) {}

Shape Shape::grown(double by) const {
    if (kind == BOX) return Shape(BOX, {half[0] + by, half[1] + by, half[2] + by}, 0.0, 0.0);
    return Shape(kind, half, half_length, radius + by);
}

Vec3 position_of(const float* matrix, const Grid& grid) {
    Vec3 out;
    for (int i = 0; i < 3; ++i) out[i] = (matrix[4 * i + 3] - grid.corner[i]) * grid.inverse;
    return out;
}

Pose pose_of(const float* matrix, const Grid& grid) {
    Pose pose;
    pose.position = position_of(matrix, grid);
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) pose.rotation[i][k] = matrix[4 * i + k];
    return pose;
}

bool is_pose(const float* matrix) {
    constexpr float ORTHONORMAL = 1e-3f;
    Quad rows[4];
    std::memcpy(rows, matrix, sizeof(rows));
    // In the fourth lane 0, or not a number where the position is none; then the position is out of the way.
    const Quad position = 0.0f * rows[0] + 0.0f * rows[1] + 0.0f * rows[2];
    const QuadIndex three = {-1, -1, -1, 0};
    const Quad x = (Quad)((QuadIndex)rows[0] & three), y = (Quad)((QuadIndex)rows[1] & three);
    const Quad z = (Quad)((QuadIndex)rows[2] & three);
    // The columns are orthonormal: their squares, and the products of each with the next, three at a time.
    const Quad squares = x * x + y * y + z * z - Quad{1.0f, 1.0f, 1.0f, 0.0f};
    const Quad products = x * next_of(x) + y * next_of(y) + z * next_of(z);
    const Quad volume = z * (next_of(x) * after_next_of(y) - after_next_of(x) * next_of(y));
    const Quad last = rows[3] - Quad{0.0f, 0.0f, 0.0f, 1.0f};
    const auto small = [](const Quad& a) { return (a <= ORTHONORMAL) & (a >= -ORTHONORMAL); };
    const auto right = small(squares) & small(products) & small(last) & small(position);
    return (right[0] & right[1] & right[2] & right[3]) != 0 && volume[0] + volume[1] + volume[2] > 0.0f;
}

Verdict judge(const Grid& grid, const Shape& shape, const Vec3& position) {
    if (empty(grid)) return Verdict::FREE;
    const Nearby near = nearby(grid, position);
    const bool free = near.at_least > shape.outer + MARGIN, hit = near.at_most <= shape.inner - MARGIN;
    return Verdict(2 - 2 * int(free) - int(hit));  // never both
}

bool touches(const Grid& grid, const Shape& shape, const Pose& pose) {
    return first_contact(grid, shape, pose, {0.0, 0.0, 0.0}, true) == 0.0;
}

static bool collides(const Grid& grid, const Shape& shape, const Pose& pose) {
    const Verdict verdict = judge(grid, shape, pose.position);
    return verdict == Verdict::HIT || (verdict == Verdict::MAYBE && touches(grid, shape, pose));
}

static Vec3 between(const Vec3& start, const Vec3& end) {
    return {end[0] - start[0], end[1] - start[1], end[2] - start[2]};
}

bool passes(const Grid& grid, const Shape& shape, const Vec3& start, const Vec3& end) {
    if (empty(grid)) return true;
    const Vec3 way = between(start, end);
    return nearby(grid, along(start, way, 0.5)).at_least > shape.outer + 0.5 * norm(way) + MARGIN;
}

double touched_fraction(const Grid& grid, const Shape& shape, const Pose& start, const Pose& end, bool any) {
    if (passes(grid, shape, start.position, end.position)) return 1.0;
    const Vec3 way = between(start.position, end.position);
    Vec3 axis{};
    const bool turns = shape.kind != Shape::SPHERE && start.rotation != end.rotation;
    const double angle = turns ? turn_between(start.rotation, end.rotation, axis) : 0.0;
    if (angle == 0.0) {
        const double contact = first_contact(grid, shape, start, way, any);
        return contact <= 1.0 ? std::min(contact, 1.0 - 1e-7) : 1.0;
    }
    if (collides(grid, shape, start)) return 0.0;
    // A point that turns by φ / 2 to either side of the middle is off by at most 2 R sin(φ / 4).
    const int parts = std::max(1, int(std::ceil(0.5 * shape.outer * angle / TURN_SLACK)));
    const Shape grown = shape.grown(2.0 * shape.outer * std::sin(0.25 * angle / parts));
    const Vec3 part_way{way[0] / parts, way[1] / parts, way[2] / parts};
    for (int part = 0; part < parts; ++part) {
        const Pose pose{turned(axis, angle * (part + 0.5) / parts, start.rotation),
                        along(start.position, way, double(part) / parts)};
        if (nearby(grid, along(pose.position, part_way, 0.5)).at_least >
            grown.outer + 0.5 * norm(part_way) + MARGIN)
            continue;
        const double contact = first_contact(grid, grown, pose, part_way, any);
        if (contact <= 1.0) return std::min((part + contact) / parts, 1.0 - 1e-7);
    }
    return collides(grid, shape, end) ? 1.0 - 1e-7 : 1.0;
}

void fetch(const Grid& grid, const Vec3& point) {
    if (!empty(grid)) __builtin_prefetch(&grid.distance[Place(grid, point).voxel]);
}

double clearance(const Grid& grid, const Vec3& point) { return empty(grid) ? NEVER : nearby(grid, point).at_least; }

}  // namespace splatrl
