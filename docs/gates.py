"""Makes docs/physics/gates.jpg: a quadrotor in a track of gates, from beside it and as it sees them.

python docs/gates.py
"""

import math
from pathlib import Path

import torch
from PIL import Image

from splatrl.build import build_world
from splatrl.cameras import Cameras, intrinsics, look_at
from splatrl.configuration import load_config
from splatrl.envs.tasks import Gates
from splatrl.envs.tasks.base import Anywhere, Step
from splatrl.envs.world import World

TRACK = 7
"""Of the tests."""
EVERY = 15
"""Steps between the views."""
EYE, FOV = (0.3, -2.75, 1.6), math.radians(85.0)
"""Of the view from beside it, metres, world."""
SIDE = (900, 600)
SMALL = 200


def main() -> None:
    """Fly a track, and put views of it side by side."""
    cfg = load_config(["task=gates", f"robot.image_width={SMALL}", f"robot.image_height={SMALL}"])
    world = build_world(cfg)
    assert isinstance(world, World) and isinstance(world.task, Gates)
    task, renderer = world.task, world.drawing.renderer
    begun = task.episodes(world.plan.starts, TRACK + 1, 0)
    state, memory = begun["state"][TRACK:], {key: begun[key][TRACK:] for key in task.memory_spec}
    anywhere = Anywhere(lambda: state, torch.Generator())
    egos, flown = [], [state]
    for step in range(task.max_steps):
        if step % EVERY == 0:
            cameras = world.robot.cameras(task.motion.body_to_world(state))
            egos.append(renderer.pixels(cameras, task.parts(state, memory))[0])
        action = task.teacher(state, memory)
        move = task.motion.move(state, action, world.checker)
        verdict = task.judge(Step(state, action, move, memory, torch.empty(0)), anywhere)
        state, memory = move.state, dict(verdict.memory)
        flown.append(state)
        if verdict.terminated.any():
            break
    at = flown[len(flown) // 2]
    now = {"gate": torch.tensor([[task.track.gates // 2]])}
    gates = task.places[int(at[0, 0]), 1:, :3].float()
    view = Cameras(look_at(EYE, gates.mean(0) - torch.tensor([0.0, 0.0, 0.3]))[None], intrinsics(FOV, *SIDE), *SIDE)
    beside = renderer.pixels(view, task.parts(at, now))[0]
    picture = Image.new("RGB", (SIDE[0] + SMALL * 2, SIDE[1]), "white")
    picture.paste(Image.fromarray(beside.numpy()), (0, 0))
    for number, ego in enumerate(egos[:6]):
        picture.paste(Image.fromarray(ego.numpy()), (SIDE[0] + SMALL * (number % 2), SMALL * (number // 2)))
    folder = Path(__file__).parent / "physics"
    folder.mkdir(exist_ok=True)
    picture.save(folder / "gates.jpg", quality=88)


if __name__ == "__main__":
    main()
