// Levels of detail from the arrays that Python keeps of them.
#pragma once

#include <nanobind/nanobind.h>

#include "levels.h"

namespace splatrl {

// Throws std::invalid_argument where the arrays are not levels of these Gaussians.
Levels levels_of(const nanobind::dict& arrays, const GaussianArrays& gaussians);

}  // namespace splatrl
