"""Measures the cost of a scene's terrain in physics, the accuracy of its ground, and how deep robots penetrate walls.

    python benchmarks/terrain.py                  # a minute, with the backyard and, if it is found, the kitchen
    python benchmarks/terrain.py --rounds 3 --json

A second table compares tasks with the same tasks without the boxes that only ``task.leeway`` makes necessary.

Times are microseconds of one core, in the first table for the robot ``wheels`` driving around with a ball ahead of it.
Plane and terrain are stepped in turns, so their ratio is reliable. Penetration is measured after robots have driven
straight ahead for five seconds, into whatever wall they meet.
"""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import median
from time import perf_counter, process_time
from typing import Any

import mujoco
import numpy as np
import torch
from machine import measured_machine
from record import print_markdown, write_json
from scenes import SCENES

import splatrl
from splatrl.collision import Occupancy
from splatrl.envs.nesting import layers
from splatrl.motions import PhysicsMotion
from splatrl.physics import Terrain
from splatrl.physics.boxes import merged_boxes, solid_above
from splatrl.physics.ground import fit_ground
from splatrl.renderers import NativeRenderer
from splatrl.scenes import Scene, backyard, read_scene

HALF = 1.0
"""Half the side of the robots' area, metres: ±HALF along x and y."""
REACH = 0.3
ROBOTS, STEPS = 64, 10
WALL = 5.0
"""Seconds of driving straight ahead into a wall."""


@dataclass(frozen=True)
class Result:
    """One row of the table."""

    scene: str
    boxes: str
    count: int
    made: float
    micros: float
    plane: float
    ratio: float
    height_mm: float
    tilt_deg: float
    penetration_mm: float


def places() -> dict[str, tuple[Scene, list[list[float]]]]:
    """Return the scenes, each with a place that robots can reach."""
    found = {"backyard": (backyard(), [[0.6, 0.4, 0.4]])}
    kitchen = SCENES / "kitchen" / "kitchen.spz"
    if kitchen.is_file():
        found["kitchen"] = read_scene(kitchen, world_from_splat={"axes": ["x", "-z", "y"]}), [[0.4, 0.4, 1.05]]
    return found


def robot() -> PhysicsMotion:
    """Make the motion of the robot ``wheels`` with a ball, on one core."""
    lower, upper = (-HALF, -HALF), (HALF, HALF)
    return PhysicsMotion("wheels", "eye", {"ball": "ball"}, ["ball"], lower=lower, upper=upper, threads=1)


def standing(motion: PhysicsMotion, count: int) -> torch.Tensor:
    """Draw states in which robot and ball do not touch the terrain of a motion."""
    draw = np.random.default_rng(0)
    at = torch.from_numpy(draw.uniform((-HALF, -HALF, 0.0), (HALF, HALF, math.tau), (100 * count, 3)))
    states, ball = motion.placed(at), motion.thing("ball")
    states[:, ball.start] = at[:, 0] + 0.4 * at[:, 2].cos()
    states[:, ball.start + 1] = at[:, 1] + 0.4 * at[:, 2].sin()
    boxes = motion.terrain.boxes
    ahead = states[:, ball.start : ball.start + 2]
    inside = ((ahead[:, None] - boxes[:, :2]).abs() < boxes[:, 3:5] + 0.1).all(2).any(1)
    free = motion.clear(states) & ~inside
    return states[free][:count]


def spent(motion: PhysicsMotion, states: torch.Tensor) -> float:
    """Measure the microseconds of a substep while robots drive around at random."""
    generator = torch.Generator().manual_seed(0)
    low, high = motion.limits
    begin = process_time()
    for _ in range(STEPS):
        action = low + (high - low) * torch.rand(len(states), len(low), generator=generator)
        states = motion.physics.step(states, action).state
    return 1e6 * (process_time() - begin) / (STEPS * len(states) * motion.physics.substeps)


def deepest(motion: PhysicsMotion, states: torch.Tensor) -> float:
    """Return the deepest penetration of robots into boxes after ``WALL`` seconds of driving ahead, millimetres."""
    model = motion.physics.model
    for _ in range(round(WALL / motion.time_step)):
        states = motion.physics.step(states, motion.limits[1] * torch.tensor([1.0, 0.0]).expand(len(states), 2)).state
    data, worst = mujoco.MjData(model), 0.0
    for state in states.numpy():
        data.qpos[:], data.qvel[:] = state[motion.layout.positions], state[motion.layout.velocities]
        mujoco.mj_forward(model, data)
        worst = min([worst, *(c.dist for c in data.contact if 0 in model.geom_bodyid[c.geom])])
    return -1000 * worst


def measure(name: str, scene: Scene, seeds: list[list[float]], rounds: int) -> list[Result]:
    """Measure the rows of a scene, which differ in the boxes that the terrain keeps, from few to all."""
    around = ([-HALF - REACH] * 2 + [0.0], [HALF + REACH] * 2 + [1.2])
    occupancy = Occupancy.from_scene(scene, seeds, around, fill=0.2)
    lower, upper = (-HALF, -HALF), (HALF, HALF)
    ground = fit_ground(NativeRenderer(scene.gaussians), occupancy, lower, upper)
    plane = torch.from_numpy(ground.plane)
    corners = np.array([[x, y] for x in (-HALF, HALF) for y in (-HALF, HALF)])
    height = 1000 * float(np.abs(ground.height(corners)).max())
    kinds = {
        f"within {HALF + REACH:g} m and below 0.35 m": (HALF + REACH, 0.35),
        f"within {HALF + REACH:g} m and below 0.6 m": (HALF + REACH, 0.6),
        "below 0.6 m": (1e3, 0.6),
        "all": (1e3, 1e3),
    }
    motions: dict[str, tuple[PhysicsMotion, int, float]] = {}
    for kind, (reach, top) in kinds.items():
        begin = perf_counter()
        boxes = torch.from_numpy(merged_boxes(solid_above(occupancy, ground, (-reach, -reach), (reach, reach), top)))
        made = perf_counter() - begin
        motion = robot()
        motion.stand_on(Terrain(plane, boxes))
        motions[kind] = motion, len(boxes), made
    bare = robot()
    bare.stand_on(Terrain(plane, torch.zeros(0, 6, dtype=torch.float64)))
    states = standing(motions["all"][0], ROBOTS)
    times: dict[str, list[float]] = {kind: [] for kind in ["plane", *motions]}
    for _ in range(rounds):
        times["plane"].append(spent(bare, states))
        for kind, (motion, _, _) in motions.items():
            times[kind].append(spent(motion, states))
    result = []
    for kind, (motion, count, made) in motions.items():
        ratio = median(a / b for a, b in zip(times[kind], times["plane"], strict=True))
        tilt, into = math.degrees(ground.tilt), deepest(motion, states[:16])
        micros = median(times[kind]), median(times["plane"])
        result.append(Result(name, kind, count, made, *micros, ratio, height, tilt, into))
    return result


def with_leeway(task: str, rounds: int) -> list[str]:
    """Compare a task in the backyard with the same task without leeway: numbers of boxes, physics, whole steps."""
    counts, moves, steps = [], [], []
    for words in ([], ["task.leeway=0"]):
        env = splatrl.make_env(["device=cpu", f"task={task}", "task.motion.threads=1", *words], batch_size=[ROBOTS])
        base = layers(env)[0]
        torch.manual_seed(0)
        td = env.rand_action(env.reset())
        counts.append(len(base.task.motion.terrain.boxes))
        moves.append(partial(base.task.motion.move, td["state"], td["action"], base.checker))
        steps.append(partial(env.step, td))
    ratios = [[seconds(whole) / seconds(less) for _ in range(rounds)] for whole, less in (moves, steps)]
    return [task, *map(str, counts), *(f"{median(each):.2f}" for each in ratios)]


def seconds(call: Callable[[], object]) -> float:
    """Measure the CPU time of some calls."""
    begin = process_time()
    for _ in range(STEPS):
        call()
    return process_time() - begin


def row(r: Result) -> list[str]:
    """Format a result as the cells of a table."""
    cost = [f"{r.micros:.1f}", f"{r.plane:.1f}", f"{r.ratio:.2f}"]
    return [r.scene, r.boxes, str(r.count), f"{r.made:.2f}", *cost, f"{r.penetration_mm:.2f}"]


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", action="store_true", help="write benchmarks/results/<date>-cpu-terrain.json")
    options = parser.parse_args()
    machine: Any = measured_machine()
    print(machine)
    results = [result for name, place in places().items() for result in measure(name, *place, options.rounds)]
    for name in dict.fromkeys(result.scene for result in results):
        first = next(result for result in results if result.scene == name)
        print(f"{name}: ground within {first.height_mm:.1f} mm and {first.tilt_deg:.2f}° of the truth")
    header = ["scene", "boxes", "number", "built, s", "µs per substep", "plane alone", "ratio", "into a wall, mm"]
    print_markdown(header, [row(result) for result in results])
    header = ["task", "boxes", "without leeway", "physics of a step, ratio", "whole step, ratio"]
    print_markdown(header, [with_leeway(task, options.rounds) for task in ("walk", "route")])
    if options.json:
        print(f"written to {write_json('terrain', machine, results)}")


if __name__ == "__main__":
    main()
