// Places where the tests' emulator counts how often a warp passes, which is as often as its busiest lane does. Compiled
// to nothing everywhere else.
#pragma once

namespace splatrl {

enum class Pass {
    node,     // test a node of a tree
    groups,   // test the groups of two nodes
    test,     // test a Gaussian
    key,      // count, deal or gather a key
    slab,     // sort a slab
    place,    // find the place of a key in its slab
    compare,  // compare a key with another
    project,  // project a Gaussian
    color,    // colour a splat, and begin to note its cells
    row,      // go through a row of cells that a splat may meet
    cell,     // note a cell
    chunk,    // fetch a chunk of splats on a cell
    pair,     // blend up to two splats over a cell
    count
};

}  // namespace splatrl

#ifdef COUNT_PASSES
static_assert(COUNT_PASSES == int(splatrl::Pass::count), "the emulator has a place for each");
#endif

#ifndef PASS
#define PASS(what)
#endif
