"""Measures how many frames a second the native renderer makes, exact, of ego views.

    python benchmarks/render.py                       # the kitchen (where it is found) and a synthetic room
    python benchmarks/render.py --scene my.ply --size 128 96 --batch 256 --threads 1 4 --json

Scenes and thread counts take turns, round by round, and each gets its median: a shared machine drifts by tens of
percent within seconds, so only figures of one run compare.
"""

import argparse
import datetime
import json
import math
import os
import platform
import statistics
import subprocess
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from tqdm import tqdm

from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.native import _core
from splatrl.renderers import NativeRenderer
from splatrl.scenes import Gaussians, read_gaussians, similarity

ROOT = Path(__file__).parents[1]
SCENES = Path(os.environ.get("SPLATRL_SCENES", ROOT.parent / "shared" / "scenes"))
EYE_HEIGHT = 1.05
"""Metres above the floor."""


@dataclass
class Result:
    """One row of the table; a frame is one camera."""

    scene: str
    gaussians: int
    sh_degree: int
    visible: int
    width: int
    height: int
    batch: int
    threads: int
    frames_per_second: float
    slowest: float
    fastest: float


def synthetic_room(count: int = 200_000, degree: int = 3) -> Gaussians:
    """A room of 4 × 4 × 2.4 m: flat Gaussians on its walls and dust in the air, the same on every machine."""
    g = torch.Generator().manual_seed(0)
    means = (torch.rand(count, 3, generator=g) - 0.5) * torch.tensor([4.0, 4.0, 2.4]) + torch.tensor([0.0, 0.0, 1.2])
    walls = torch.rand(count, generator=g) < 0.9
    axis, side = torch.randint(0, 3, (count,), generator=g), torch.randint(0, 2, (count,), generator=g)
    low, high = torch.tensor([-2.0, -2.0, 0.0]), torch.tensor([2.0, 2.0, 2.4])
    rows = walls.nonzero().squeeze(1)
    means[rows, axis[rows]] = torch.where(side == 0, low[axis], high[axis])[rows]
    return Gaussians(
        means=means,
        quats=torch.nn.functional.normalize(torch.randn(count, 4, generator=g), dim=1),
        scales=torch.exp(math.log(0.008) + 0.7 * torch.randn(count, 3, generator=g)),
        opacities=torch.rand(count, generator=g).clamp_min(0.05),
        sh=0.3 * torch.randn(count, (degree + 1) ** 2, 3, generator=g),
        batch_size=[count],
    )


def ego_views(batch: int, width: int, height: int) -> Cameras:
    """Level views within a metre of the origin, 90 degrees wide, in random directions."""
    g = torch.Generator().manual_seed(1)
    positions = torch.rand(batch, 3, generator=g) * torch.tensor([2.0, 2.0, 0.0]) - torch.tensor(
        [1.0, 1.0, -EYE_HEIGHT]
    )
    yaws = 2 * math.pi * torch.rand(batch, generator=g)
    forward = torch.stack([yaws.cos(), yaws.sin(), torch.zeros(batch)], 1)
    return Cameras(look_at(positions, positions + forward), intrinsics(math.pi / 2, width, height), width, height)


def chosen_scenes(paths: list[str]) -> dict[str, Gaussians]:
    """The scenes of the command line, in the frame of their files; without any, the kitchen and the synthetic room."""
    if paths:
        return {Path(path).stem: read_gaussians(path) for path in paths}
    scenes = {"synthetic": synthetic_room()}
    kitchen = SCENES / "kitchen" / "kitchen.spz"
    if kitchen.is_file():
        scenes["kitchen"] = read_gaussians(kitchen).transformed(similarity(["x", "-z", "y"]))
    else:
        print(f"kitchen: not found at {kitchen}; set SPLATRL_SCENES to measure it")
    return scenes


def measure(scenes: dict[str, Gaussians], cameras: Cameras, threads: list[int], rounds: int) -> list[Result]:
    """Time whole batches of ``pixels``, every renderer once a round."""
    renderers = {(name, count): NativeRenderer(g, threads=count) for name, g in scenes.items() for count in threads}
    for renderer in tqdm(renderers.values(), desc="warming up"):
        renderer.pixels(cameras)
    rates: dict[tuple[str, int], list[float]] = {key: [] for key in renderers}
    for _ in tqdm(range(rounds), desc="measuring"):
        for key, renderer in renderers.items():
            start = time.perf_counter()
            renderer.pixels(cameras)
            rates[key].append(len(cameras) / (time.perf_counter() - start))
    results = []
    for (name, count), seen in rates.items():
        visible = int(renderers[name, count].visible(cameras).float().mean())
        results.append(
            Result(
                scene=name,
                gaussians=len(scenes[name].means),
                sh_degree=scenes[name].sh_degree,
                visible=visible,
                width=cameras.width,
                height=cameras.height,
                batch=len(cameras),
                threads=count,
                frames_per_second=round(statistics.median(seen), 1),
                slowest=round(min(seen), 1),
                fastest=round(max(seen), 1),
            )
        )
    return results


def print_table(results: list[Result]) -> None:
    """The results as Markdown."""
    print("\n| scene | Gaussians | SH | visible | image | batch | threads | frames/s (slowest to fastest) |")
    print("|---|---|---|---|---|---|---|---|")
    for r in results:
        rate = f"{r.frames_per_second:.0f} ({r.slowest:.0f} to {r.fastest:.0f})"
        print(
            f"| {r.scene} | {r.gaussians:,} | {r.sh_degree} | {r.visible:,} | {r.width}x{r.height} | {r.batch} "
            f"| {r.threads} | {rate} |"
        )


def processor() -> str:
    """The name that the processor gives itself."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        names = [line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if "model name" in line]
        if names:
            return names[0]
    return platform.processor() or platform.machine()


def write_json(results: list[Result]) -> Path:
    """Keep the results with the machine and the commit that they belong to."""
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    today = datetime.date.today().isoformat()
    path = ROOT / "benchmarks" / "results" / f"{today}-cpu-render.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    machine = {"processor": processor(), "cores": len(os.sched_getaffinity(0)), "isa": _core.isa()}
    record = {"commit": commit.strip(), "machine": machine, "results": [asdict(result) for result in results]}
    path.write_text(json.dumps(record, indent=2) + "\n")
    return path


def main() -> None:
    """Parse the command line, measure, show."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="*", default=[], help="splat files, z up and metric")
    parser.add_argument("--size", nargs=2, type=int, default=[64, 64], metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--batch", type=int, default=128, help="cameras a call")
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--json", action="store_true", help="write benchmarks/results/<date>-cpu-render.json")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    cameras = ego_views(arguments.batch, *arguments.size)
    results = measure(chosen_scenes(arguments.scene), cameras, arguments.threads, arguments.rounds)
    print_table(results)
    if arguments.json:
        print(f"\nwritten to {write_json(results)}")


if __name__ == "__main__":
    main()
