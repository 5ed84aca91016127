"""Compiles all kernels of splatrl into the cache, without a GPU.

    python benchmarks/gpu_kernels.py --arch sm_90 --archive kernels.tar.gz    # for the cache of another machine
    python benchmarks/gpu_kernels.py --arch sm_90 --count                     # only counts those in the cache

Another machine finds a compiled kernel if its sources, its macros and the version of NVRTC are the same.
"""

import argparse
import tarfile
from collections.abc import Iterator
from itertools import product
from pathlib import Path

from collision import BODIES
from gpu_device import CHAINS, RATE, STEPS

from splatrl.capture.fitting import structs as fit
from splatrl.collision import cuda as collide
from splatrl.files import replacing
from splatrl.native.cuda.compiler import compiled, kept_at, nvrtc_versions
from splatrl.renderers import cuda as render

DEGREES = range(4)


def kernels() -> Iterator[tuple[str | Path, dict[str, int]]]:
    """Yield every source with every combination of its macros."""
    for antialiased, degree, levels, parts in product((True, False), DEGREES, (True, False), (False, True)):
        yield "render", render.kernel_defines(antialiased, degree, levels, parts)
    yield "place", {}
    for body in BODIES.values():
        yield "collide", collide.kernel_defines(body)
    for degree in DEGREES:
        yield "fit", fit.kernel_defines(degree)
    yield RATE, {"CHAINS": CHAINS, "STEPS": STEPS}


def main() -> None:
    """Compile, pack and count kernels."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arch", default="sm_90", help="architecture of the GPU; default sm_90")
    parser.add_argument("--archive", type=Path, help=".tar.gz file to write, with the compiled kernels")
    parser.add_argument("--count", action="store_true", help="only count the kernels in the cache")
    options = parser.parse_args()
    paths = []
    for source, defines in kernels():
        if not options.count:
            compiled(source, options.arch, defines)
        paths.append(kept_at(source, options.arch, defines))
    nvrtc = "".join(nvrtc_versions())
    found = [path for path in paths if path.is_file()]
    if options.archive:
        with replacing(options.archive) as stream, tarfile.open(fileobj=stream, mode="w:gz") as archive:
            for path in found:
                archive.add(path, path.name)
    print(f"kernels: {len(found)} of {len(paths)} for {options.arch} are in the cache; NVRTC {nvrtc or 'none'}")


if __name__ == "__main__":
    main()
