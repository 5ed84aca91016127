#include <nanobind/nanobind.h>

#include <stdexcept>

#include "arrays.h"
#include "bindings.h"
#include "buffer.h"
#include "interpreter.h"
#include "stereo.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

using Images = Tensor<const float, -1, -1, -1>;
using Poses = Tensor<const float, -1, 4, 4>;
using Rows = Tensor<const int64_t, -1>;
using Neighbours = Tensor<const int64_t, -1, -1>;

StereoPhotos photos_of(const Images& grey, const Poses& poses, const Tensor<const float, 3, 3>& K) {
    if (poses.shape(0) != grey.shape(0)) throw std::invalid_argument("camera_to_world: expected one pose per photo");
    if (grey.shape(1) < 1 || grey.shape(2) < 1 || grey.shape(1) > 4096 || grey.shape(2) > 4096)
        throw std::invalid_argument("grey: expected 1 to 4096 pixels per side");
    return {grey.data(), poses.data(), K.data(), int(grey.shape(2)), int(grey.shape(1))};
}

// The task of one photo, whose list of neighbours ends at the first -1.
StereoTask task_of(const Rows& rows, const Neighbours& neighbours, size_t item, size_t photos) {
    StereoTask task{};
    if (neighbours.shape(0) != rows.shape(0))
        throw std::invalid_argument("neighbours: expected one list per entry of rows");
    task.photo = size_t(rows.data()[item]);
    task.neighbours = neighbours.data() + item * neighbours.shape(1);
    while (task.neighbour_count < neighbours.shape(1) && task.neighbours[task.neighbour_count] >= 0)
        if (task.neighbours[task.neighbour_count++] >= int64_t(photos))
            throw std::invalid_argument("neighbours: expected indices of photos");
    if (task.photo >= photos) throw std::invalid_argument("rows: expected indices of photos");
    return task;
}

void require_out(const Tensor<float, -1, -1, -1>& out, const Images& images) {
    for (size_t axis = 0; axis < 3; ++axis)
        if (out.shape(axis) != images.shape(axis)) throw std::invalid_argument("out: expected the shape of the images");
}

void sweep(Images grey, Poses poses, Tensor<const float, 3, 3> K, Rows rows, Neighbours neighbours,
           Tensor<const float, -1, 2> ranges, Tensor<const float, -1, 3> soundings, Rows firsts, int depths,
           Tensor<float, -1, -1, -1> out, size_t threads) {
    const StereoPhotos photos = photos_of(grey, poses, K);
    require_out(out, grey);
    if (ranges.shape(0) != rows.shape(0)) throw std::invalid_argument("ranges: expected one range per entry of rows");
    if (firsts.shape(0) != grey.shape(0) + 1) throw std::invalid_argument("firsts: expected one more than photos");
    for (size_t photo = 0; photo < grey.shape(0); ++photo)
        if (firsts.data()[photo] < 0 || firsts.data()[photo] > firsts.data()[photo + 1] ||
            firsts.data()[photo + 1] > int64_t(soundings.shape(0)))
            throw std::invalid_argument("firsts: expected ascending rows of soundings");
    if (depths < 16 || depths > 256 || depths % 16 != 0)
        throw std::invalid_argument("depths: expected a multiple of 16 from 16 to 256");
    std::vector<StereoTask> tasks;
    for (size_t item = 0; item < rows.shape(0); ++item) {
        StereoTask task = task_of(rows, neighbours, item, grey.shape(0));
        const int64_t first = firsts.data()[task.photo];
        task.low = ranges.data()[2 * item], task.high = ranges.data()[2 * item + 1], task.depths = depths;
        task.soundings = soundings.data() + 3 * first;
        task.sounding_count = size_t(firsts.data()[task.photo + 1] - first);
        if (task.neighbour_count > 0) tasks.push_back(task);
    }
    const StereoKernels& kernels = stereo_kernels_of(choose_isa());
    const Release release;
    const size_t area = photos.area(), whole = area * size_t(depths);
    parallel_for(tasks.size(), threads, [&](size_t, size_t item) {
        const Buffer<float> best = make_buffer<float>(STEREO_BEST * whole), volume = make_buffer<float>(whole),
                            total = make_buffer<float>(whole), planes = make_buffer<float>(STEREO_PLANES * area);
        kernels.sweep(photos, tasks[item], {best.get(), volume.get(), total.get(), planes.get()},
                      out.data() + tasks[item].photo * area);
    });
}

void agree(Images inverse, Poses poses, Tensor<const float, 3, 3> K, Rows rows, Neighbours neighbours, float tolerance,
           int least, Tensor<float, -1, -1, -1> out, size_t threads) {
    const StereoPhotos photos = photos_of(inverse, poses, K);
    require_out(out, inverse);
    std::vector<StereoTask> tasks;
    for (size_t item = 0; item < rows.shape(0); ++item)
        tasks.push_back(task_of(rows, neighbours, item, inverse.shape(0)));
    const StereoKernels& kernels = stereo_kernels_of(choose_isa());
    const Release release;
    parallel_for(tasks.size(), threads, [&](size_t, size_t item) {
        kernels.agree(photos, tasks[item], inverse.data(), tolerance, least,
                      out.data() + tasks[item].photo * photos.area());
    });
}

}  // namespace

void bind_stereo(nb::module_& m) {
    using nb::arg;
    m.def("sweep", &sweep, arg("grey"), arg("camera_to_world"), arg("K"), arg("rows"), arg("neighbours"),
          arg("ranges"), arg("soundings"), arg("firsts"), arg("depths"), arg("out"), arg("threads"));
    m.def("agree", &agree, arg("inverse"), arg("camera_to_world"), arg("K"), arg("rows"), arg("neighbours"),
          arg("tolerance"), arg("least"), arg("out"), arg("threads"));
}

}  // namespace splatrl
