"""Measures the overhead of an env's calls around renderer and checker, with every view in the cache.

    python benchmarks/overhead.py             # the grid task in the backyard, one thread
    python benchmarks/overhead.py --batches 1 64

``step`` is a step without resets, ``automatic`` a step with TorchRL's automatic resets, and ``reset one`` a reset of a
single row to a given state. ``alone`` is the time that renderer and checker take for the moves and views of that step;
``alone, with resets`` adds the views of the rows that are reset. ``TorchRL`` is the step of an env with the same specs
that does nothing. Times are CPU time of the thread. Ratios of a call to renderer and checker alone are computed per
round; their median and quartiles are printed. All rows take turns, round by round. To compare two versions, use
``against.py``.
"""

import argparse
import time
from collections.abc import Callable
from statistics import median

import torch
from record import print_markdown
from tensordict import TensorDictBase
from timing import quartiles, take_turns
from torchrl.envs import EnvBase

import splatrl
from splatrl.envs.nesting import layers

CALLS = 20
"""Calls per turn; a single call is too short to time."""
WARM_UP = 60
"""Number of steps before measuring, after which episodes have all lengths."""
AT_ONCE = 256
"""Views per call that fills the cache."""
ALONE = {"step": "alone", "automatic": "alone, with resets"}
"""The row with which each call is compared."""


class Idle(EnvBase):
    """An env whose steps return a fixed result, to measure TorchRL's own part of a step.

    Args:
        env: env whose specs it copies.
        after: what every step returns.
    """

    batch_locked = True

    def __init__(self, env: EnvBase, after: TensorDictBase):
        super().__init__(device=env.device, batch_size=env.batch_size)
        self.observation_spec, self.action_spec = env.observation_spec.clone(), env.full_action_spec.clone()
        self.reward_spec, self.done_spec = env.full_reward_spec.clone(), env.full_done_spec.clone()
        self.after = after

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self.after.copy()

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        raise NotImplementedError

    def _set_seed(self, seed: int | None) -> None:
        pass


def calls_of(batch: int) -> dict[str, Callable[[], object]]:
    """Return the calls for one batch size, each with a fixed input, so that its views are in the cache."""
    env = splatrl.make_env(["device=cpu", "curriculum=none"], batch_size=[batch])
    base = layers(env)[0]
    motion = base.task.motion
    for states in motion.states().split(AT_ONCE):
        base.drawing.renderer.pixels(base.robot.cameras(motion.body_to_world(states)))
    torch.manual_seed(0)
    td = env.reset()
    for _ in range(WARM_UP):
        _, td = env.step_and_maybe_reset(env.rand_action(td))
    given = env.rand_action(td)
    one = torch.zeros(batch, 1, dtype=torch.bool)
    one[0] = True
    stepped, begun = env.step_and_maybe_reset(given.clone(False))
    after = stepped["next"]
    idle = Idle(env, after)
    start, end = (
        motion.body_to_world(given["state"]),
        motion.body_to_world(motion.advance(given["state"], given["action"])),
    )
    seen = base.robot.cameras(motion.body_to_world(after["state"]))
    anew = base.robot.cameras(motion.body_to_world(begun["state"]))[after["done"].flatten()]

    def alone(*views: object) -> None:
        base.checker.free_fraction(start, end)
        for cameras in views:
            base.drawing.renderer.pixels(cameras)

    return {
        "step": lambda: env.step(given.clone(False)),
        "automatic": lambda: env.step_and_maybe_reset(given.clone(False)),
        "reset one": lambda: env.reset(given.clone(False).set("_reset", one.clone()), set_state=True),
        "alone": lambda: alone(seen),
        "alone, with resets": lambda: alone(seen, *([anew] if len(anew) else [])),
        "TorchRL": lambda: idle.step(given.clone(False)),
    }


def repeated(call: Callable[[], object]) -> Callable[[], None]:
    """Return a turn, which repeats a call."""

    def turn() -> None:
        for _ in range(CALLS):
            call()

    return turn


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 64, 1024])
    parser.add_argument("--rounds", type=int, default=30)
    options = parser.parse_args()
    torch.set_num_threads(1)
    turns = {(b, name): repeated(call) for b in options.batches for name, call in calls_of(b).items()}
    seconds = take_turns(turns, options.rounds, time.thread_time)
    rows = []
    for (batch, name), times in seconds.items():
        row = [str(batch), name, f"{1e6 * median(times) / CALLS:,.0f}", f"{1e6 * min(times) / CALLS:,.0f}", ""]
        if name in ALONE:
            ratios = [mine / base for mine, base in zip(times, seconds[batch, ALONE[name]], strict=True)]
            low, middle, high = quartiles(ratios)
            row[-1] = f"{middle:.2f} ({low:.2f} to {high:.2f})"
        rows.append(row)
    print_markdown(["robots", "call", "µs, median", "fastest round", "× renderer and checker alone"], rows)


if __name__ == "__main__":
    main()
