// The extension module splatrl.native._core: the C++ side of splatrl.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "bindings.h"
#include "isa.h"

namespace splatrl {

void bind_isa(nanobind::module_& m) {
    m.def("isa", [] { return std::string(isa_name(choose_isa())); });
    m.def("supported_isas", [] {
        std::vector<std::string> names;
        for (Isa isa : supported_isas()) names.emplace_back(isa_name(isa));
        return names;
    });
}

}  // namespace splatrl

NB_MODULE(_core, m) {
    nanobind::set_leak_warnings(false);  // threads of PyTorch may still hold functions when Python exits
    splatrl::bind_collision(m);
    splatrl::bind_distances(m);
    splatrl::bind_fit(m);
    splatrl::bind_flat_scene(m);
    splatrl::bind_geodesics(m);
    splatrl::bind_gru(m);
    splatrl::bind_interpreter(m);
    splatrl::bind_isa(m);
    splatrl::bind_lattice_steps(m);
    splatrl::bind_levels(m);
    splatrl::bind_occupancy(m);
    splatrl::bind_packed(m);
    splatrl::bind_policy(m);
    splatrl::bind_pool(m);
    splatrl::bind_rays(m);
    splatrl::bind_renderer(m);
    splatrl::bind_row_index(m);
    splatrl::bind_rows(m);
    splatrl::bind_stereo(m);
    splatrl::bind_trunk(m);
    splatrl::bind_appearance(m);
    splatrl::bind_weather(m);
}
