// Scenes as arrays, to keep in a file or in part.
#pragma once

#include <nanobind/nanobind.h>

#include <array>

#include "scene.h"

namespace splatrl {

// The arrays of a scene by name, as numpy arrays; renderers/packed.py describes them.
nanobind::dict to_arrays(const Scene& scene);

// The scene that arrays hold, in which colours are relative to this background.
// Throws std::invalid_argument for arrays of other shapes, or with numbers that lead out of them.
Scene from_arrays(const nanobind::dict& arrays, std::array<float, 3> background);

}  // namespace splatrl
