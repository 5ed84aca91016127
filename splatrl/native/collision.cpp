#include "collision.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "contact.h"

namespace splatrl {

namespace {

constexpr double SLACK = 1e-9;   // voxels: what touches to the last bit touches
constexpr double MARGIN = 1e-4;  // voxels: beyond single precision of the distance field
constexpr double HALF_DIAGONAL = 0.8660254037844387;

struct Range {
    int first, last;
};

// The voxels that [low, high] touches along an axis.
Range touched(double low, double high, int size) {
    const double first = std::clamp(std::ceil(low - SLACK) - 1.0, 0.0, double(size));
    const double last = std::clamp(std::floor(high + SLACK), -1.0, double(size - 1));
    return {int(first), int(last)};
}

// Bits [first, last] of a word, both in [0, 63].
uint64_t mask_of(int first, int last) { return ~0ull << first & ~0ull >> (63 - last); }

// Call visit(z) for each solid voxel of a column from `first` to `last`, until it returns true.
template <class Visit>
bool any_solid(const uint64_t* column, int first, int last, const Visit& visit) {
    for (int word = first / 64; first <= last && word <= last / 64; ++word) {
        const int low = std::max(first - 64 * word, 0), high = std::min(last - 64 * word, 63);
        for (uint64_t bits = column[word] & mask_of(low, high); bits != 0; bits &= bits - 1)
            if (visit(64 * word + __builtin_ctzll(bits))) return true;
    }
    return false;
}

// Call visit(x, y, column, z range) for each column with something solid within a box.
template <class Visit>
bool any_column(const Grid& grid, const Vec3& low, const Vec3& high, const Visit& visit) {
    const Range xs = touched(low[0], high[0], grid.size[0]), ys = touched(low[1], high[1], grid.size[1]);
    const Range zs = touched(low[2], high[2], grid.size[2]);
    const auto nothing = [](int) { return true; };
    for (int x = xs.first; x <= xs.last; ++x)
        for (int y = ys.first; y <= ys.last; ++y) {
            const uint64_t* column = &grid.bits[(size_t(x) * grid.size[1] + y) * grid.words];
            if (any_solid(column, zs.first, zs.last, nothing) && visit(x, y, column, zs)) return true;
        }
    return false;
}

// A box on a straight way, against voxels. Two convex bodies are apart where their shadows on some normal are: of the
// box, the voxel, and each pair of an edge of one and an edge of the other; while the box moves, the way is an edge too.
class BoxSweep {
public:
    BoxSweep(const Shape& shape, const Pose& pose, const Vec3& way) : start_(pose.position), way_(way) {
        Mat3 edges;  // of the box, unit
        for (int i = 0; i < 3; ++i) edges[i] = {pose.rotation[0][i], pose.rotation[1][i], pose.rotation[2][i]};
        for (int i = 0; i < 3; ++i) middle_[i] = start_[i] + 0.5 * way[i];
        const double length = norm(way);
        for (int i = 0; i < 3; ++i) {
            Vec3 world{};
            world[i] = 1.0;
            add(shape, edges, world, true);
            add(shape, edges, edges[i], true);
            for (const Vec3& edge : edges) add(shape, edges, cross(world, edge), true);
            if (length == 0.0) continue;
            const Vec3 direction{way[0] / length, way[1] / length, way[2] / length};
            add(shape, edges, cross(world, direction), false);
            add(shape, edges, cross(edges[i], direction), false);
        }
    }

    // The voxels of a column that are touched on the way.
    Range column(int x, int y, Range zs) const {
        double low = zs.first - middle_[2] + 0.5, high = zs.last - middle_[2] + 0.5;  // of the voxels' centres
        const double dx = x + 0.5 - middle_[0], dy = y + 0.5 - middle_[1];
        for (int i = 0; i < count_; ++i) {
            const Normal& n = normals_[i];
            const double base = n.axis[0] * dx + n.axis[1] * dy;
            if (n.inverse_z == 0.0) {
                if (std::fabs(base) > n.swept) return {0, -1};
                continue;
            }
            const double center = -base * n.inverse_z, half = n.swept * std::fabs(n.inverse_z);
            low = std::max(low, center - half);
            high = std::min(high, center + half);
            if (low > high + 2.0 * SLACK) return {0, -1};
        }
        return {int(std::ceil(low + middle_[2] - 0.5 - SLACK)), int(std::floor(high + middle_[2] - 0.5 + SLACK))};
    }

    // The first t in [0, 1] at which a voxel is touched, or NEVER.
    double contact(int x, int y, int z) const {
        const Vec3 apart{x + 0.5 - start_[0], y + 0.5 - start_[1], z + 0.5 - start_[2]};
        double enter = 0.0, leave = 1.0;
        for (int i = 0; i < count_; ++i) {
            const Normal& n = normals_[i];
            if (!n.still) continue;
            const double from = dot(apart, n.axis), speed = n.speed;
            if (std::fabs(speed) < 1e-12) {
                if (std::fabs(from) > n.reach) return NEVER;
                continue;
            }
            const double a = (from - n.reach) / speed, b = (from + n.reach) / speed;
            enter = std::max(enter, std::min(a, b));
            leave = std::min(leave, std::max(a, b));
        }
        return enter <= leave ? enter : NEVER;
    }

private:
    struct Normal {
        Vec3 axis;
        double inverse_z;  // 0 where the axis has no z
        double reach;      // of box and voxel together, at rest
        double swept;      // and with half the way
        double speed;      // of the box along the axis
        bool still;        // whether it belongs to the bodies, not to the way
    };

    void add(const Shape& shape, const Mat3& edges, const Vec3& axis, bool still) {
        const double length = norm(axis);
        if (length < 1e-6) return;  // parallel edges: another normal decides
        double reach = SLACK;
        for (int i = 0; i < 3; ++i) reach += 0.5 * std::fabs(axis[i]) + shape.half[i] * std::fabs(dot(edges[i], axis));
        const double speed = dot(way_, axis);
        const double inverse_z = std::fabs(axis[2]) > 1e-9 ? 1.0 / axis[2] : 0.0;
        normals_[count_++] = {axis, inverse_z, reach, reach + 0.5 * std::fabs(speed), speed, still};
    }

    Vec3 start_, way_, middle_;
    Normal normals_[21];
    int count_ = 0;
};

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
        const BoxSweep sweep(shape, pose, way);
        any_column(grid, low, high, [&](int x, int y, const uint64_t* column, Range zs) {
            const Range within = sweep.column(x, y, zs);
            return any_solid(column, std::max(within.first, zs.first), std::min(within.last, zs.last), [&](int z) {
                first = std::min(first, any ? 0.0 : sweep.contact(x, y, z));
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
    any_column(grid, low, high, [&](int x, int y, const uint64_t* column, Range zs) {
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

struct Nearby {
    double at_least, at_most;  // distance to the nearest solid voxel, and to the nearest centre of one
};

Nearby nearby(const Grid& grid, const Vec3& point) {
    Vec3 within;
    int index[3];
    double outside = 0.0, to_center = 0.0;
    for (int i = 0; i < 3; ++i) {
        within[i] = std::clamp(point[i], 0.0, double(grid.size[i]));
        index[i] = std::min(int(within[i]), grid.size[i] - 1);
        outside += (point[i] - within[i]) * (point[i] - within[i]);
        to_center += (within[i] - index[i] - 0.5) * (within[i] - index[i] - 0.5);
    }
    const double between =
        grid.distance[(size_t(index[0]) * grid.size[1] + index[1]) * grid.size[2] + index[2]];
    to_center = std::sqrt(to_center);
    const double inside = std::max(between * (1.0 - 1e-6) - HALF_DIAGONAL - to_center, 0.0);
    if (outside == 0.0) return {inside, between + to_center};
    return {std::sqrt(outside + inside * inside), NEVER};
}

bool empty(const Grid& grid) { return grid.size[0] == 0 || grid.size[1] == 0 || grid.size[2] == 0; }

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

double Shape::inner() const {
    return kind == BOX ? std::min({half[0], half[1], half[2]}) : radius;
}

double Shape::outer() const {
    return kind == BOX ? norm(half) : radius + (kind == CAPSULE ? half_length : 0.0);
}

Shape Shape::grown(double by) const {
    Shape out = *this;
    if (kind == BOX)
        for (double& extent : out.half) extent += by;
    else
        out.radius += by;
    return out;
}

bool read_pose(const float* matrix, const Grid& grid, Pose& pose) {
    constexpr double ORTHONORMAL = 1e-3;
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) pose.rotation[i][k] = matrix[4 * i + k];
        pose.position[i] = (matrix[4 * i + 3] - grid.corner[i]) / grid.resolution;
    }
    const Mat3& r = pose.rotation;
    const double off = std::max({std::fabs(dot(r[0], r[0]) - 1.0), std::fabs(dot(r[1], r[1]) - 1.0),
                                 std::fabs(dot(r[2], r[2]) - 1.0), std::fabs(dot(r[0], r[1])),
                                 std::fabs(dot(r[1], r[2])), std::fabs(dot(r[2], r[0]))});
    const double bottom = std::max({std::fabs(matrix[12]), std::fabs(matrix[13]), std::fabs(matrix[14]),
                                    std::fabs(matrix[15] - 1.0f)});
    double sum = 0.0;  // not finite where any number is not
    for (int i = 0; i < 16; ++i) sum += std::fabs(double(matrix[i]));
    return sum <= std::numeric_limits<double>::max() && off <= ORTHONORMAL && bottom <= ORTHONORMAL &&
           dot(cross(r[0], r[1]), r[2]) > 0.0;
}

bool collides(const Grid& grid, const Shape& shape, const Pose& pose) {
    if (empty(grid)) return false;
    const Nearby near = nearby(grid, pose.position);
    if (near.at_least > shape.outer() + MARGIN) return false;
    if (near.at_most <= shape.inner() - MARGIN) return true;
    return first_contact(grid, shape, pose, {0.0, 0.0, 0.0}, true) == 0.0;
}

double touched_fraction(const Grid& grid, const Shape& shape, const Pose& start, const Pose& end, bool any) {
    if (empty(grid)) return 1.0;
    Vec3 way, middle;
    for (int i = 0; i < 3; ++i) {
        way[i] = end.position[i] - start.position[i];
        middle[i] = start.position[i] + 0.5 * way[i];
    }
    if (nearby(grid, middle).at_least > shape.outer() + 0.5 * norm(way) + MARGIN) return 1.0;
    Vec3 axis{};
    const bool turns = shape.kind != Shape::SPHERE && start.rotation != end.rotation;
    const double angle = turns ? turn_between(start.rotation, end.rotation, axis) : 0.0;
    if (angle == 0.0) {
        const double contact = first_contact(grid, shape, start, way, any);
        return contact <= 1.0 ? std::min(contact, 1.0 - 1e-7) : 1.0;
    }
    if (collides(grid, shape, start)) return 0.0;
    // A point that turns by φ / 2 to either side of the middle is off by at most 2 R sin(φ / 4).
    const int parts = std::max(1, int(std::ceil(0.5 * shape.outer() * angle / TURN_SLACK)));
    const Shape grown = shape.grown(2.0 * shape.outer() * std::sin(0.25 * angle / parts));
    const Vec3 part_way{way[0] / parts, way[1] / parts, way[2] / parts};
    for (int part = 0; part < parts; ++part) {
        const Pose pose{turned(axis, angle * (part + 0.5) / parts, start.rotation),
                        along(start.position, way, double(part) / parts)};
        if (nearby(grid, along(pose.position, part_way, 0.5)).at_least >
            grown.outer() + 0.5 * norm(part_way) + MARGIN)
            continue;
        const double contact = first_contact(grid, grown, pose, part_way, any);
        if (contact <= 1.0) return std::min((part + contact) / parts, 1.0 - 1e-7);
    }
    return collides(grid, shape, end) ? 1.0 - 1e-7 : 1.0;
}

double clearance(const Grid& grid, const Vec3& point) { return empty(grid) ? NEVER : nearby(grid, point).at_least; }

}  // namespace splatrl
