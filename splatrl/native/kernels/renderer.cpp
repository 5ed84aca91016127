// Renders one tile from start to finish, compiled once for each instruction set.
#include <ctime>
#include <utility>

#include "kernels/blend.h"
#include "kernels/cull.h"
#include "kernels/project.h"
#include "kernels/sort.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Accumulates the CPU time in milliseconds that this thread spends in each stage; other work on the machine does not
// count. Reading the clock takes a good part of a microsecond, so it is read only where it is asked for.
class Stopwatch {
public:
    explicit Stopwatch(bool runs) : runs_(runs), last_(runs ? now() : 0.0) {}

    void add_to(float& stage) {
        if (!runs_) return;
        const double time = now();
        stage += float(time - last_);
        last_ = time;
    }

private:
    static double now() {
        std::timespec time{};
#if defined(CLOCK_THREAD_CPUTIME_ID)
        clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
#else
        std::timespec_get(&time, TIME_UTC);
#endif
        return 1e3 * double(time.tv_sec) + 1e-6 * double(time.tv_nsec);
    }

    bool runs_;
    double last_;
};

// Draw from near to far, in steps: what is in front veils what lies behind, which then needs fewer Gaussians.
template <bool ANTIALIASED, bool WITH_DEPTH>
static Effort render(const Row& row, const Tile& whole, Tile& tile, const Scratch& scratch) {
    Effort effort{};
    Stopwatch watch(row.timed);
    const auto project = row.ranked ? project_groups<ANTIALIASED, true> : project_groups<ANTIALIASED, false>;
    const auto sort = row.ranked ? sort_by_depth<true> : sort_by_depth<false>;
    bool peaked = false;
    Branches branches{scratch.branches, 0}, later{scratch.later, 0};
    branch_out(row, whole, branches);
    const bool stepped = ANTIALIASED && !row.ranked && next_border(branches) < BEYOND;
    if (stepped) {
        if (tile.top > whole.top) {
            tile.bottom = tile.top;
            return effort;
        }
        tile = whole;
    } else if (tile.top > whole.top || tile.bottom < whole.bottom) {
        branch_out(row, tile, branches);
    }
    Blocks blocks;
    start_tile<WITH_DEPTH>(scratch, blocks, tile, row.background);
    Veil veil;
    uint32_t blended = 0;  // splats blended so far
    for (bool first = true, more = true; more; first = false) {
        const float border = stepped ? next_border(branches) : BEYOND;
        const uint32_t groups = cull(row, tile, border, first ? nullptr : &veil, branches, later, scratch.groups);
        effort.projected += groups * GROUP;
        effort.visible = project(row, tile, groups, scratch, effort.visible, peaked);
        watch.add_to(effort.project_ms);
        more = border < BEYOND;
        uint64_t* keys = scratch.keys + blended;
        const uint32_t open = effort.visible - blended;
        const uint32_t near = more ? bring_near(scratch, keys, open, border) : open;
        sort(scratch, keys, near);
        watch.add_to(effort.sort_ms);
        const bool firm = row.finished <= MIN_TRANSMITTANCE;
        const auto blend =
            firm ? (peaked ? blend_splats<WITH_DEPTH, true, true> : blend_splats<WITH_DEPTH, true, false>)
                 : (peaked ? blend_splats<WITH_DEPTH, false, true> : blend_splats<WITH_DEPTH, false, false>);
        effort.blended += blend(tile, row, keys, near, scratch, blocks);
        blended += near;
        if (more) draw_veil(scratch.pixels, blocks.finished, veil);
        watch.add_to(effort.blend_ms);
        std::swap(branches, later);
    }
    return effort;
}

static Effort render_any(const Row& row, const Tile& whole, Tile& piece, bool antialiased, bool with_depth,
                         const Scratch& scratch) {
    if (antialiased)
        return with_depth ? render<true, true>(row, whole, piece, scratch)
                          : render<true, false>(row, whole, piece, scratch);
    return with_depth ? render<false, true>(row, whole, piece, scratch)
                      : render<false, false>(row, whole, piece, scratch);
}

extern const RenderTile render_tile = render_any;

}  // namespace SPLATRL_ISA
}  // namespace splatrl
