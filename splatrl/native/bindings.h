// One function for each part of the module. A new part declares its own here, and module.cpp calls it.
#pragma once

#include <nanobind/nanobind.h>

namespace splatrl {

void bind_collision(nanobind::module_& m);
void bind_distances(nanobind::module_& m);
void bind_fit(nanobind::module_& m);
void bind_flat_scene(nanobind::module_& m);
void bind_geodesics(nanobind::module_& m);
void bind_gru(nanobind::module_& m);
void bind_interpreter(nanobind::module_& m);
void bind_isa(nanobind::module_& m);
void bind_lattice_steps(nanobind::module_& m);
void bind_levels(nanobind::module_& m);
void bind_occupancy(nanobind::module_& m);
void bind_packed(nanobind::module_& m);
void bind_policy(nanobind::module_& m);
void bind_pool(nanobind::module_& m);
void bind_rays(nanobind::module_& m);
void bind_renderer(nanobind::module_& m);
void bind_row_index(nanobind::module_& m);
void bind_rows(nanobind::module_& m);
void bind_stereo(nanobind::module_& m);
void bind_trunk(nanobind::module_& m);
void bind_appearance(nanobind::module_& m);
void bind_weather(nanobind::module_& m);

}  // namespace splatrl
