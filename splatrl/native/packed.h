// Scenes as arrays, to be kept in a file, whole or in part.
#pragma once

#include <nanobind/nanobind.h>

#include <array>

#include "scene.h"

namespace splatrl {

// The arrays of a scene, as numpy arrays by name; renderers/packed.py describes them.
nanobind::dict to_arrays(const Scene& scene);

// The scene that such arrays hold, with colours relative to this background.
// Throws std::invalid_argument for arrays of other shapes, or with indices that lead outside them.
Scene from_arrays(const nanobind::dict& arrays, std::array<float, 3> background);

}  // namespace splatrl
