#include <algorithm>
#include <array>
#include <stdexcept>

#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>

#include "arrays.h"
#include "bindings.h"
#include "buffer.h"
#include "interpreter.h"
#include "ray_kernels.h"
#include "rigid.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

CastBeams cast_beams_of(Isa isa) {
    switch (isa) {
#ifdef SPLATRL_X86
        case Isa::avx512: return avx512::cast_beams;
        case Isa::avx2: return avx2::cast_beams;
#endif
        default: return portable::cast_beams;
    }
}

namespace {

constexpr size_t CHUNK = 4096;  // rays per work item of a thread

using Room = Tensor<const uint8_t, -1, -1, -1>;

// Casts beams from many bodies against one grid, of which it keeps a copy.
class RayCaster {
public:
    RayCaster(const Room& room, std::array<double, 3> corner, double resolution) : cast_(cast_beams_of(choose_isa())) {
        if (!(resolution >= 1e-4 && resolution <= 1e3))
            throw std::invalid_argument("RayCaster: resolution out of bounds");
        empty_ = room.size() == 0;
        room_ = make_buffer<uint8_t>(room.size() + 1);
        std::copy_n(room.data(), room.size(), room_.get());
        room_[room.size()] = 0;
        grid_ = {{int(room.shape(1)), int(room.shape(2)), int(room.shape(0))}, resolution, 1.0 / resolution,
                 {corner[0], corner[1], corner[2]}, room_.get()};
    }

    // poses [count, 4, 4]; beams [along, 3] in the frames of the poses; out [count, along] metres. Returns -1, or the
    // first pose that is not rigid, in which case nothing is written.
    int64_t ranges(uintptr_t poses, uintptr_t beams, uintptr_t out, size_t count, size_t along, double reach,
                   size_t threads) const {
        const auto* matrices = reinterpret_cast<const float*>(poses);
        auto* metres = reinterpret_cast<float*>(out);
        for (size_t row = 0; row < count; ++row)
            if (!is_pose_by_fours(matrices + 16 * row)) return int64_t(row);
        const size_t rays = count * along, chunks = (rays + CHUNK - 1) / CHUNK;
        if (empty_) {
            std::fill_n(metres, rays, float(reach));
            return -1;
        }
        const Beams all{matrices, reinterpret_cast<const float*>(beams), along};
        const Release release;
        parallel_for(chunks, std::min(threads, chunks), [&](size_t, size_t chunk) {
            cast_(grid_, all, chunk * CHUNK, std::min(CHUNK, rays - chunk * CHUNK), reach, metres);
        });
        return -1;
    }

private:
    Buffer<uint8_t> room_;
    bool empty_;
    RayGrid grid_;
    CastBeams cast_;
};

}  // namespace

void bind_rays(nb::module_& m) {
    nb::class_<RayCaster>(m, "RayCaster")
        .def(nb::init<Room, std::array<double, 3>, double>(), nb::arg("room"), nb::arg("corner"), nb::arg("resolution"))
        .def("ranges", &RayCaster::ranges);
}

}  // namespace splatrl
