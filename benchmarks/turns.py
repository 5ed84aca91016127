"""Runs the measurements of ``against.py`` in the checkout whose Python runs it.

It prints the name of each measurement as a line of JSON, then reads numbers of turns and answers each with seconds,
until it reads 0; at the end it prints null. Measurements must run in older checkouts as well, so they keep to the
interfaces that users have.
"""

import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from statistics import median

import torch
from collision import BODIES, RESOLUTIONS, queries_in, yard
from scenes import BUILT

import splatrl
from splatrl.building import build_trainer, build_world
from splatrl.collision import NativeChecker
from splatrl.configuration import load_config
from splatrl.envs import World
from splatrl.envs.world import Worlds
from splatrl.renderers import NativeRenderer
from splatrl.training import Cloner, CloningSettings

Turn = Callable[[], object]
VIEWS = 64
STEPS = 20
"""Steps of an env per turn."""
QUERIES = 16_384
YARDS = 8


def training(task: str) -> Iterator[tuple[str, Turn]]:
    """Make measurements of collecting and testing with the initial policy, and of learning after a few iterations."""
    cfg = load_config([f"task={task}", "device=cpu", "curriculum=none", "logger.num_test_episodes=64"])
    torch.manual_seed(0)
    trainer = build_trainer(cfg, build_world(cfg), Path(tempfile.mkdtemp()))
    ppo = trainer.ppo
    yield f"collect {task}", ppo.collect
    yield f"test {task}", trainer.test
    for _ in range(4):
        ppo.iterate()
    batch = ppo.collect()
    yield f"learn {task}", lambda: ppo.learner.learn(batch)


def remembering() -> Iterator[tuple[str, Turn]]:
    """Make measurements of a policy with memory: imitation for one pass, acting, and learning from one batch."""
    cfg = load_config(["task=pointnav", "ppo=taught", "memory=gru", "device=cpu", "logger.num_test_episodes=64"])
    torch.manual_seed(0)
    trainer = build_trainer(cfg, build_world(cfg), Path(tempfile.mkdtemp()))
    ppo = trainer.ppo
    batch = ppo.collect()
    rows, cloner = batch.flatten(0, 1), Cloner(ppo.model, CloningSettings(1, 256, 1e-4, 0.5))
    shown = {
        **{key: rows[key] for key in cloner.reads},
        "target": torch.nn.functional.one_hot(rows["action"], ppo.env.action_spec.space.n).float(),
        "value_target": torch.zeros(len(rows)),
        "frame": rows["step_count"].flatten(),
    }
    yield "imitate with memory", lambda: cloner.fit(shown)
    yield "learn with memory", lambda: ppo.learner.learn(batch)
    yield "collect with memory", ppo.collect
    yield "test with memory", trainer.test


def steps(batch: int) -> Iterator[tuple[str, Turn]]:
    """Make measurements of steps of the grid task with all views in the cache, and of renderer and checker alone."""
    env = splatrl.make_env(["device=cpu", "curriculum=none"], batch_size=[batch])
    base = getattr(env, "base_env", env)
    motion = base.task.motion
    for states in motion.states().split(VIEWS):
        base.drawing.renderer.pixels(base.robot.cameras(motion.body_to_world(states)))
    torch.manual_seed(0)
    td = env.reset()
    for _ in range(60):
        _, td = env.step_and_maybe_reset(env.rand_action(td))
    given = env.rand_action(td)

    def repeated(call: Turn) -> Turn:
        def turn() -> None:
            for _ in range(STEPS):
                call()  # drops the result, so that its memory is reused

        return turn

    yield f"step {batch}", repeated(lambda: env.step(given.clone(False)))
    yield f"step with resets {batch}", repeated(lambda: env.step_and_maybe_reset(given.clone(False)))
    state = given["state"]
    start, end = motion.body_to_world(state), motion.body_to_world(motion.advance(state, given["action"]))
    cameras = base.robot.cameras(start)

    def alone() -> object:
        return base.checker.free_fraction(start, end), base.drawing.renderer.pixels(cameras)

    yield f"step, its renderer and checker alone {batch}", repeated(alone)


def frames(scene: str, tolerance: float, size: int) -> Iterator[tuple[str, Turn]]:
    """Make the measurement of drawing views of a scene on one core."""
    subject = BUILT[scene]()
    if subject is None:
        return
    renderer = NativeRenderer(subject.scene, threads=1, tolerance=tolerance)
    cameras = subject.room.views(max(4, VIEWS * 64 * 64 // size**2), size, size)
    name = f"{tolerance} px" if tolerance else "exact"
    yield f"frames {scene} {name} {size}²", lambda: renderer.pixels(cameras)


def queries() -> Iterator[tuple[str, Turn]]:
    """Make measurements of queries on one core: bodies and yards of ``collision.py``, and moves of the grid task."""
    for (voxels, resolution), near in product(RESOLUTIONS.items(), (False, True)):
        occupancy = yard(resolution)
        start, end = queries_in(occupancy, near, QUERIES)
        for name, body in BODIES.items():
            checker = NativeChecker(occupancy, body, threads=1)
            what = f"query {name}, {voxels}, {'near' if near else 'uniform'}"
            yield what, lambda checker=checker, start=start: checker.collides(start)
            yield f"{what}, swept", lambda checker=checker, start=start, end=end: checker.sweeps(start, end)
    world = build_world(load_config(["device=cpu"]))
    assert isinstance(world, World)
    generator = torch.Generator().manual_seed(0)
    state = world.plan.states[torch.randint(len(world.plan.states), (QUERIES,), generator=generator)]
    checker, motion = NativeChecker(world.occupancy, world.robot.body, threads=1), world.task.motion
    begin = motion.body_to_world(state)
    for name, action in (("step", 0), ("turn", 4)):
        ahead = motion.body_to_world(motion.advance(state, torch.full((QUERIES,), action)))
        yield f"query of the grid task, {name}", lambda ahead=ahead: checker.free_fraction(begin, ahead)


def places() -> Iterator[tuple[str, Turn]]:
    """Make measurements of what places cost before the first step of a navigation task, from a warm cache."""
    cfg = load_config(["device=cpu", "task=pointnav", "scene=yards", f"scene.count={YARDS}"])
    built = build_world(cfg)
    assert isinstance(built, Worlds)
    task, checker = built.worlds[0].task, built.worlds[0].checker
    yield "places: goals of pointnav in one yard", lambda: task.choose_goals(checker)
    yield f"places: {YARDS} yards of pointnav", lambda: build_world(cfg)


GROUPS: dict[str, Callable[[], Iterator[tuple[str, Turn]]]] = {
    "learn collect test grid": lambda: training("grid"),
    "learn collect test fps": lambda: training("fps"),
    "imitate learn collect test": remembering,
    "step 1": lambda: steps(1),
    "step 32": lambda: steps(32),
    "step 64": lambda: steps(64),
    "step 1024": lambda: steps(1024),
    **{
        f"frames {scene} {tolerance} {size}": lambda scene=scene, tolerance=tolerance, size=size: frames(
            scene, tolerance, size
        )
        for scene in BUILT
        for tolerance, size in ((0.0, 64), (0.5, 64), (0.0, 256), (0.5, 256), (0.0, 512), (0.5, 512))
    },
    "query": queries,
    "places:": places,
}
"""Makers of groups of measurements; each key lists the first words of all names in its group."""


def wanted(words: list[str]) -> Iterator[tuple[str, Turn]]:
    """Yield the measurements whose names begin with one of the words; all without words."""
    for key, make in GROUPS.items():
        if words and not any(word.split()[0] in key.split() for word in words):
            continue
        for name, turn in make():
            if not words or any(name.startswith(word) for word in words):
                yield name, turn


def main() -> None:
    """Run the protocol described above."""
    torch.set_num_threads(1)
    said = sys.stdout
    sys.stdout = sys.stderr
    for name, turn in wanted(sys.argv[1:]):
        turn()
        print(json.dumps(name), file=said, flush=True)
        while count := int(sys.stdin.readline() or 0):
            seconds = []
            for _ in range(count):
                begun = time.process_time()
                turn()
                seconds.append(time.process_time() - begun)
            print(json.dumps(median(seconds)), file=said, flush=True)
        print(json.dumps(0), file=said, flush=True)
    print("null", file=said, flush=True)


if __name__ == "__main__":
    main()
