"""Measures the cost of robots with physics: the physics alone, with images, and with their links in the images.

    python benchmarks/physics.py                                        # the backyard, a minute
    python benchmarks/physics.py --scene kitchen=kitchen.spz --rounds 9

Times are CPU time of one thread. All calls take turns, round by round, in one process, so the ratios are reliable.
"""

import argparse
import math
from dataclasses import dataclass
from functools import partial
from statistics import median
from time import process_time
from typing import Any

import torch
from machine import measured_machine
from record import print_markdown, write_json
from timing import take_turns
from torch import Tensor

from splatrl.building import build_world
from splatrl.configuration import load_config
from splatrl.envs.drawing import Shot
from splatrl.envs.world import World
from splatrl.motions import PhysicsMotion
from splatrl.physics import level_ground
from splatrl.renderers import Parts

BATCH = 64
LINKS, GAUSSIANS = 13, 800
"""Number of links of the robot in the images, and of Gaussians per link."""
BEAMS, REACH = 64, 10.0
"""Number of lidar beams, and how far they reach, metres."""


@dataclass(frozen=True)
class Row:
    """One measurement: the median over the rounds.

    Attributes:
        scene: name of the scene.
        what: what was measured.
        value: median over the rounds.
        unit: unit of the value.
        fastest: value in the best round.
    """

    scene: str
    what: str
    value: float
    unit: str
    fastest: float


def drawn(world: World, state: Tensor, memory: dict[str, Tensor], motion: PhysicsMotion) -> Tensor:
    """Draw the views of some states with everything that moves in them."""
    cameras = world.robot.cameras(motion.body_to_world(state))
    return world.drawing.draw(Shot(cameras, memory, world.task.parts(state, memory))).pixels


def alone(world: World, state: Tensor, motion: PhysicsMotion) -> Tensor:
    """Draw the scene alone from the same places."""
    return world.drawing.draw(Shot(world.robot.cameras(motion.body_to_world(state)))).pixels


def with_links(world: World, cameras: Any, parts: Parts | None) -> Tensor:
    """Draw the scene with links in view, or with None the scene alone."""
    return world.drawing.renderer.pixels(cameras, parts)


def links_ahead(world: World, motion: PhysicsMotion, state: Tensor) -> Parts:
    """Place the links of a robot 0.6 m ahead of each camera, beside and above one another."""
    poses = motion.body_to_world(state)
    model = torch.cat([torch.zeros(len(state), 1), torch.ones(len(state), LINKS)], 1).long()
    stands = torch.eye(4).repeat(len(state), 1 + LINKS, 1, 1)
    for link in range(LINKS):
        offset = torch.tensor([0.6, 0.12 * (link % 4) - 0.18, 0.1 * (link // 4) - 0.2, 1.0])
        stands[:, 1 + link] = poses
        stands[:, 1 + link, :3, 3] = (poses @ offset)[:, :3]
    return Parts(model, stands)


def level_beams(count: int) -> Tensor:
    """Return beams all around: [R, 3] float32."""
    azimuth = torch.arange(count) * math.tau / count
    return torch.stack([azimuth.cos(), azimuth.sin(), torch.zeros(count)], 1)


def measure(name: str, overrides: list[str], rounds: int) -> list[Row]:
    """Measure all rows of one scene."""
    settings = ["task=push", "device=cpu", "renderer.threads=1", "task.motion.threads=1", *overrides]
    timing = ["task.motion.time_step=0.1", "task.motion.substep=0.005"]
    world = build_world(load_config([*settings, *timing]))
    assert isinstance(world, World) and isinstance(world.task.motion, PhysicsMotion)
    motion = world.task.motion
    episodes = world.task.episodes(world.plan.starts, BATCH, 0)  # type: ignore[attr-defined]
    state = episodes.pop("state")
    action = motion.action_spec.rand((BATCH,))
    plain = PhysicsMotion("wheels", "eye", {"ball": "ball"}, ["ball"], threads=1)
    plain.stand_on(level_ground())
    cast = motion.body_to_world(state), level_beams(BEAMS), REACH
    cameras, links = world.robot.cameras(motion.body_to_world(state)), links_ahead(world, motion, state)
    exact = build_world(load_config([*settings, "renderer.tolerance=0"]))
    assert isinstance(exact, World)

    def both() -> None:
        after = motion.move(state, action, world.checker).state
        drawn(world, after, episodes, motion)

    measured = take_turns(
        {
            "physics": partial(motion.move, state, action, world.checker),
            "plane": partial(plain.move, state, action, world.checker),
            "physics and picture": both,
            "picture": partial(drawn, world, state, episodes, motion),
            "scene": partial(alone, world, state, motion),
            "links": partial(with_links, world, cameras, links),
            "no links": partial(with_links, world, cameras, None),
            "beams to things": partial(motion.ranges, state, *cast),
            "beams to voxels": partial(world.checker.ranges, *cast),
            "exact links": partial(with_links, exact, cameras, links),
            "exact scene": partial(with_links, exact, cameras, None),
        },
        rounds,
        process_time,
    )
    steps = motion.physics.substeps * BATCH

    def ratio(one: str, other: str, what: str) -> Row:
        pairs = [a / b for a, b in zip(measured[one], measured[other], strict=True)]
        return Row(name, what, median(pairs), "×", min(pairs))

    physics = measured["physics"]
    return [
        Row(name, "env steps of physics, 10 Hz, 5 ms substeps", BATCH / median(physics), "1/s", BATCH / min(physics)),
        Row(name, "one substep", 1e6 * median(physics) / steps, "µs", 1e6 * min(physics) / steps),
        ratio("physics", "plane", "a step here / on a plane alone"),
        ratio("physics and picture", "picture", "physics and image / image alone"),
        ratio("picture", "scene", "image with robot, ball and mark / scene alone"),
        ratio("links", "no links", f"image with {LINKS} links of {GAUSSIANS} Gaussians / scene alone"),
        ratio("exact links", "exact scene", "the same, exact images"),
        ratio("beams to things", "physics", f"{BEAMS} lidar beams against the ball / a step of physics"),
        ratio("beams to voxels", "physics", f"{BEAMS} lidar beams against voxels / a step of physics"),
    ]


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="*", default=["backyard"], help="backyard, or kitchen=<path of kitchen.spz>")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", action="store_true", help="write benchmarks/results/<date>-cpu-physics.json")
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    rows: list[Row] = []
    for scene in chosen.scene:
        name, _, path = scene.partition("=")
        place = [f"scene={name}", f"scene.path={path}", *KITCHEN] if path else [f"scene={name}"]
        rows += measure(name, place, chosen.rounds)
    figures = [(row.scene, row.what, f"{row.value:.3g} {row.unit}", f"{row.fastest:.3g} {row.unit}") for row in rows]
    print_markdown(["scene", "measurement", "median", "best round"], figures)
    if chosen.json:
        print(write_json("physics", measured_machine(), rows))


KITCHEN = ["task.motion.lower=[-0.95,-0.25]", "task.motion.upper=[0.95,1.3]", "task.clearance=0.3"]
"""Overrides with the free floor of the kitchen."""

if __name__ == "__main__":
    main()
