"""Measures how long the viewer's page takes to show a scene and to redraw it, in Chromium with software rendering.

    pip install playwright && python benchmarks/viewer.py kitchen.spz
    python benchmarks/viewer.py --gaussians 1000000

Times are wall-clock times; CPU times are those of all of the browser's processes. Wall-clock times are only meaningful
on an idle machine; on a busy one, root can give the benchmark priority with ``chrt -r 1``.
"""

import argparse
import os
import shutil
import statistics
import time
from pathlib import Path

import torch
from playwright.sync_api import Page as Tab
from playwright.sync_api import sync_playwright

from splatrl.scenes import read_scene
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene, robust_bounds
from splatrl.viewer.page import Page

SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
NOTE = """
const seen = window.splats = [];
for (const name of ["drawElementsInstanced", "drawArraysInstanced"]) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) {
    draw.apply(this, given);
    if (given[given.length - 1] > 100) {
      this.readPixels(0, 0, 1, 1, this.RGBA, this.UNSIGNED_BYTE, new Uint8Array(4));  // waits until it is drawn
      seen.push([performance.now(), given[given.length - 1]]);
    }
  };
}
"""
"""Script that records in the page when splats have been drawn, in milliseconds, and how many."""


TURNS = 3
"""Number of redraws per number of splats; their median is printed."""


STILL = 20.0
"""Seconds without a new part after which no more are expected."""


def room(count: int) -> Scene:
    """Make random Gaussians in a room of 8 × 6 × 2.5 m."""
    generator = torch.Generator().manual_seed(0)
    gaussians = Gaussians(
        means=torch.rand(count, 3, generator=generator) * torch.tensor([8.0, 6.0, 2.5]),
        quats=torch.nn.functional.normalize(torch.randn(count, 4, generator=generator)),
        scales=torch.exp(0.5 * torch.randn(count, 3, generator=generator) - 4.5),
        opacities=torch.rand(count, generator=generator),
        sh=torch.rand(count, 1, 3, generator=generator),
        batch_size=[count],
    )
    return Scene("room", gaussians, robust_bounds(gaussians))


def browser_seconds() -> float:
    """Return the CPU seconds of the browser's processes, which descend from this one."""
    parents, spent = {}, {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:  # the process has just ended
            continue
        pid = int(path.parent.name)
        parents[pid], spent[pid] = int(fields[1]), int(fields[11]) + int(fields[12])
    mine = {os.getpid()}
    while more := {pid for pid, parent in parents.items() if parent in mine} - mine:
        mine |= more
    return sum(spent[pid] for pid in mine - {os.getpid()}) / os.sysconf("SC_CLK_TCK")


def turned(tab: Tab, width: int, height: int) -> float:
    """Return the seconds from a drag of the pointer until the next frame is drawn, the median of ``TURNS``."""
    spent = []
    tab.mouse.move(width // 2, height // 2)
    tab.mouse.down()
    for number in range(TURNS):
        tab.wait_for_timeout(500)
        drawn, now = tab.evaluate("[window.splats.length, performance.now()]")
        tab.mouse.move(width // 2 + 30 * (number + 1), height // 2)
        while tab.evaluate("window.splats.length") == drawn:
            tab.wait_for_timeout(5)
        spent.append((tab.evaluate(f"window.splats[{drawn}][0]") - now) / 1e3)
    tab.mouse.up()
    return statistics.median(spent)


def main() -> None:
    """Open a page, and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", help="a splat file or a folder")
    parser.add_argument("--gaussians", type=int, default=1_000_000, help="random Gaussians if no scene is given")
    parser.add_argument("--size", type=int, nargs=2, default=[1000, 640], help="size of the window, pixels")
    parser.add_argument("--most", type=int, default=250_000, help="largest number of Gaussians to redraw")
    options = parser.parse_args()
    scene = room(options.gaussians) if options.scene is None else read_scene(options.scene)
    began = time.perf_counter()
    page = Page(scene, port=0)
    seconds = time.perf_counter() - began
    print(f"{len(scene.gaussians):,} Gaussians, {page.bytes / 1e6:.1f} MB; served after {seconds:.1f} s")
    width, height = options.size
    with sync_playwright() as running:
        own = os.environ.get("SPLATRL_CHROMIUM") or shutil.which("chromium")
        browser = running.chromium.launch(executable_path=own, args=SOFTWARE)
        tab = browser.new_page(viewport={"width": width, "height": height})
        tab.add_init_script(NOTE)
        before = browser_seconds()
        tab.goto(page.address)
        counts = page.splats.counts
        known: set[int] = set()
        settled = time.monotonic()
        while max(known, default=0) < len(scene.gaussians) and (not known or time.monotonic() < settled + STILL):
            tab.wait_for_timeout(50)
            found = tab.evaluate("window.splats")  # blocks while the page draws
            spent = browser_seconds() - before
            for at, count in found:
                if count not in known:
                    print(f"{count:,} Gaussians drawn after {at / 1e3:.1f} s, {spent:.1f} CPU s", flush=True)
                    settled = time.monotonic()
                known.add(count)
        print(f"drawn automatically: {max(known):,}", flush=True)
        for parts, count in enumerate(counts, 1):
            if count > max(options.most, counts[0]):
                break
            page.splats.show(parts)
            while tab.evaluate("window.splats.at(-1)[1]") != count:
                tab.wait_for_timeout(50)
            seconds = turned(tab, width, height)
            print(f"{count:,} Gaussians: redrawn in {seconds:.2f} s", flush=True)
        browser.close()
    page.close()


if __name__ == "__main__":
    main()
