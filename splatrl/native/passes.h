// Where the tests' emulator counts how often a warp comes by, which is as often as its busiest lane does. Nothing
// elsewhere.
#pragma once

namespace splatrl {

enum class Pass {
    node,     // of a tree, tested
    groups,   // of two nodes, tested
    test,     // of a Gaussian
    key,      // counted, dealt or gathered
    slab,     // put in order
    place,    // of a key in its slab
    compare,  // with another key
    project,  // a Gaussian
    color,    // a splat, and begin to note its cells
    row,      // of cells that a splat may meet
    cell,     // noted
    chunk,    // of splats on a cell, fetched
    pair,     // of a splat and a cell, blended
    count
};

}  // namespace splatrl

#ifdef COUNT_PASSES
static_assert(COUNT_PASSES == int(splatrl::Pass::count), "the emulator has a place for each");
#endif

#ifndef PASS
#define PASS(what)
#endif
