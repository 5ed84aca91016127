"""Counts the work of a frame on a GPU, without a GPU.

    python benchmarks/gpu_counts.py                      # three scenes, a minute each on one core
    python benchmarks/gpu_counts.py kitchen --views 2 --tolerances 0.5

The tests' emulator counts how often a warp passes through each loop of cuda/render.cu, which is as often as its busiest
lane does, and how many of its lanes are active. The instructions per pass are those of the machine code for sm_90, for
antialiased images of degree 3 with level of detail, line by line as ``nvdisasm -gi`` shows them; in ``color`` they
differ for other degrees. Bytes are those that lanes read and write in global memory, cached or not.

These are counts, not measurements: they do not include waiting for memory, barriers or other warps.
"""

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass

from record import print_markdown
from scenes import NAMES, ROOT, Subject, chosen

from splatrl.renderers.cuda import CudaRenderer

sys.path.insert(0, str(ROOT))  # for the emulator of the tests

from tests.emulator import EmulatedKernels, counted

SIZE = 64
"""Width and height of a frame, pixels."""
INSTRUCTIONS = {
    "node": 175,
    "groups": 126,
    "test": 159,
    "key": 31,
    "slab": 250,
    "place": 30,
    "compare": 12,
    "project": 254,
    "color": 300,
    "row": 44,
    "cell": 20,
    "chunk": 13,
    "pair": 68,
}
"""Instructions of a warp per pass through each loop."""
BYTES = {"node": 44, "groups": 24 + 4, "test": 16, "project": 48, "color": 16}
"""Bytes of a lane per pass: a cluster and its number; bounds of a group; a sphere; a shape; its mean, read again."""
KEY_BYTES = 4 + 5 * 8
"""Bytes per candidate: its index; and its key, written, read to be counted, read and written to be sorted into buckets,
and read for its slab."""
COLOR_BYTES = 6
"""Bytes per harmonic of a visible splat."""


@dataclass(frozen=True)
class Count:
    """One line of the table, averaged over frames; the last line of a scene is the sum of the others."""

    scene: str
    tolerance: float
    loop: str
    passes: float
    busy: float
    instructions: float
    bytes: float


HEADER = ("scene", "tolerance, px", "loop", "passes of a warp", "active lanes", "warp instructions", "KB")


def row(line: Count) -> tuple[str, ...]:
    """Return a row of the table."""
    often = (f"{line.passes:,.0f}", f"{100 * line.busy:.0f} %") if line.passes else ("", "")
    sums = f"{line.instructions:,.0f}", f"{line.bytes / 1e3:,.0f}"
    return (line.scene, f"{line.tolerance:g}", line.loop, *often, *sums)


def counts(subject: Subject, tolerance: float, views: int) -> list[Count]:
    """Count the work of frames of a scene."""
    loaded: list[EmulatedKernels] = []

    def load(source: str, defines: Mapping[str, int]) -> EmulatedKernels:
        loaded.append(counted(source, defines))
        return loaded[-1]

    renderer = CudaRenderer(subject.scene, tolerance=tolerance, load=load)
    loaded[0].passes()  # reset the counts
    candidates = float(renderer.efforts(subject.room.views(views, SIZE, SIZE))[:, 0].float().mean())
    harmonics = (subject.scene.gaussians.sh_degree + 1) ** 2
    lines = []
    for loop, (passes, lanes) in loaded[0].passes().items():
        size = lanes / views * (BYTES.get(loop, 0) + (COLOR_BYTES * harmonics if loop == "color" else 0))
        if loop == "key":
            size += candidates * KEY_BYTES
        busy = lanes / 32 / passes if passes else 0.0
        each = passes / views
        lines.append(Count(subject.scene.name, tolerance, loop, each, busy, each * INSTRUCTIONS[loop], size))
    sums = sum(line.instructions for line in lines), sum(line.bytes for line in lines)
    return [*lines, Count(subject.scene.name, tolerance, "all", 0.0, 0.0, *sums)]


def main() -> None:
    """Count, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=list(NAMES), help=f"any of {', '.join(NAMES)}, or paths of scenes")
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--tolerances", type=float, nargs="+", default=[0.5, 0.0])
    options = parser.parse_args()
    lines = [
        line
        for subject in chosen(options.scenes).values()
        for tolerance in options.tolerances
        for line in counts(subject, tolerance, options.views)
    ]
    print_markdown(HEADER, [row(line) for line in lines])


if __name__ == "__main__":
    main()
