// A single float in place of the sixteen of ../lanes.h: code that includes "lanes.h" then computes for one thread of a
// GPU.
#pragma once

#include "platform.h"

#include "scalars.h"

#define SPLATRL_ISA one_lane
#define LANE_INLINE SPLAT_INLINE

namespace splatrl {
namespace SPLATRL_ISA {

constexpr int LANES = 1;
using Lanes = float;

LANE_INLINE Lanes lanes(float value) { return value; }
LANE_INLINE Lanes load(const float* from) { return *from; }
LANE_INLINE void store(float* to, Lanes value) { *to = value; }

}  // namespace SPLATRL_ISA
}  // namespace splatrl
