// Reads levels of detail from the arrays in which Python keeps them.
#pragma once

#include <nanobind/nanobind.h>

#include "levels.h"

namespace splatrl {

// Throws std::invalid_argument if the arrays are not levels of these Gaussians.
Levels levels_of(const nanobind::dict& arrays, const GaussianArrays& gaussians);

}  // namespace splatrl
