// Ray casting on a CPU, compiled once for each instruction set.
#pragma once

#include <cstddef>

#include "isa.h"
#include "rays.h"

namespace splatrl {

// The beams of a batch of bodies: ray i is beam i % along of body i / along.
struct Beams {
    const float* poses;  // [bodies, 4, 4] rigid
    const float* ways;   // [along, 3] in the frame of each body
    size_t along;
};

// Cast the rays [begin, begin + count), and write the range of each in metres, at most `reach`.
using CastBeams = void (*)(const RayGrid&, const Beams&, size_t begin, size_t count, double reach, float* metres);

namespace portable { extern const CastBeams cast_beams; }
namespace avx2 { extern const CastBeams cast_beams; }
namespace avx512 { extern const CastBeams cast_beams; }

CastBeams cast_beams_of(Isa isa);

}  // namespace splatrl
