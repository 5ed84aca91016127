"""Draws all pictures of a finished training into its run folder."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from splatrl.cameras import Cameras
from splatrl.collision.occupancy import Occupancy
from splatrl.curriculum import Plan
from splatrl.evaluation.chase import chase_cameras
from splatrl.evaluation.recording import Recording, record_episodes
from splatrl.evaluation.rollouts import Episodes
from splatrl.evaluation.start_maps import start_map, success_map
from splatrl.evaluation.starts import Chosen, varied
from splatrl.evaluation.topdown import MapView, footprint, map_window, top_down
from splatrl.evaluation.video import PANEL, rollout_video
from splatrl.motions import Motion
from splatrl.scenes.gaussians import Gaussians
from splatrl.waits import late_bar

VIDEO, START_MAP, SUCCESS_MAP = "rollouts.mp4", "starts.png", "success_map.png"
"""Names of the files. The video is the last file that an evaluation writes; with several scenes, each one shown has its
own, the last scene's last."""
FASTEST = 60
"""Maximum frame rate of a video, frames per second."""
PACE = 6
"""Steps per second in a video of robots whose steps have no duration."""
HEADROOM = 0.4
"""Height above the robot's body at which maps cut the scene open, metres."""


class Pictures:
    """Draws the results of a training, over the scene seen from above.

    Args:
        gaussians: the scene's Gaussians.
        occupancy: what is solid.
        plan: free poses and shortest paths.
        env: any env of the task; its state is left unchanged.
        folder: the run folder.
    """

    def __init__(self, gaussians: Gaussians, occupancy: Occupancy, plan: Plan, env: EnvBase, folder: Path):
        self.plan, self.env, self.folder = plan, env, folder
        robot, places = env.robot, self._planar(plan.states)[:, :2]
        half = robot.body.half_height
        cut = robot.height + half + HEADROOM
        window, wide = map_window(gaussians, places.amin(0).tolist(), places.amax(0).tolist(), cut)
        ground = top_down(gaussians, *window, cut)
        solid = footprint(occupancy, robot.height - half, robot.height + half, ground)
        overview = None if wide is None else top_down(gaussians, *wide, cut)
        self.view = MapView(ground, solid, env.task.marks(), overview)

    def starts(self, episodes: Episodes) -> Path:
        """Draw start positions and headings, coloured by success."""
        path = self.folder / START_MAP
        planar = self._planar(episodes.start)
        start_map(
            planar, episodes.success, self.view, path, self._blocked(), self._cut_off(), len(self.plan.start_rows)
        )
        return path

    def success_map(self, episodes: Episodes) -> Path:
        """Draw the success rate by start position."""
        path = self.folder / SUCCESS_MAP
        planar = self._planar(episodes.start)
        tried, every = len(episodes.start.unique(dim=0)), len(self.plan.start_rows)
        starts = "all starts" if tried == every else f"{tried:,} of {every:,} starts:"
        success_map(planar, episodes.success, self.view, path, starts, self._cut_off())
        return path

    def video(
        self,
        env: EnvBase,
        policy: Callable[[TensorDictBase], TensorDictBase],
        seed: int,
        frames: int,
        chosen: Chosen | None = None,
    ) -> Path:
        """Record one rollout per robot of ``env``, from starts spread over distances to the goal, nearest first.

        If the rollouts have more frames than the video may, it shows fewer of them, still spread over distances.

        Args:
            env: env whose robots are recorded.
            policy: policy that acts.
            seed: seed of the action sampling.
            frames: approximate maximum number of frames; at least one episode is shown to its end.
            chosen: a start for each robot with the task's memory there, for tasks that choose their own episodes.
        """
        path = self.folder / VIDEO
        rows = self.plan.start_rows
        ordered = rows[self.plan.distance[rows].argsort(stable=True)]
        count = env.numel()
        start = self.plan.states[ordered[_spread(len(ordered), count)]]
        motion = env.task.motion
        states, memory = (varied(motion, start), {}) if chosen is None else (chosen.state, chosen.memory)
        with late_bar("record", env.task.max_steps, "step") as bar:
            recordings = record_episodes(env, policy, states, seed=seed, memory=memory, progress=bar.update)
        outside = partial(self._outside, env) if motion.models else None  # without a body, there is nothing to see
        rollout_video(
            [recordings[row] for row in shown([len(recording.action) for recording in recordings], frames)],
            env.robot,
            self.view,
            path,
            env.drawing,
            motion.action_names or motion.controls,
            fps=steps_a_second(motion),
            outside=outside,
            goals=env.task.goals_for_success,
        )
        return path

    def _outside(self, env: EnvBase, recording: Recording) -> Cameras:
        """Return cameras that follow the robot of a recording and show its body."""
        place, radius = recording.body_to_world[:, :3, 3], env.robot.body.radius
        return chase_cameras(recording.planar, place, radius, env.checker, (PANEL, PANEL), env.device)

    def _planar(self, states: Tensor) -> Tensor:
        """Return positions and headings of states: [N, D] -> [N, 3], on the CPU whatever the env's device."""
        return self.env.task.motion.planar(states.to(self.env.device)).cpu()

    def _blocked(self) -> Tensor:
        """Find the positions at which the body does not fit in any heading: [M, 2] metres."""
        places, fits, _ = self._positions()
        return places[~fits]

    def _cut_off(self) -> Tensor:
        """Find the positions at which the body fits, but from which no path leads to the goal: [M, 2] metres."""
        places, fits, reaches = self._positions()
        return places[fits & ~reaches]

    def _positions(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return all positions [P, 2], and whether in some heading the body fits there, and can reach the goal: [P]."""
        free, connected = self.plan.free, self.plan.free & ~self.plan.cut_off
        places, row = self._planar(self.plan.states)[:, :2].unique(dim=0, return_inverse=True)
        fits, reaches = (torch.zeros(len(places)).index_add(0, row, some.float()) > 0 for some in (free, connected))
        return places, fits, reaches


def shown(steps: Sequence[int], frames: int) -> list[int]:
    """Choose which episodes a video shows: as many as would fit if all were as long as the longest, evenly spread.

    Choosing them without regard to their own lengths avoids a bias towards episodes that end early.

    Args:
        steps: number of steps of each episode.
        frames: approximate maximum number of frames of the video; a single episode may exceed it.
    """
    return _spread(len(steps), min(max(1, frames // max(steps)), len(steps))).tolist()


def _spread(length: int, count: int) -> Tensor:
    """Return ``count`` rows that are evenly spread over ``length`` and end with the last: [count] int64."""
    return (torch.arange(1, count + 1) * length // count - 1).clamp_min(0)


def steps_a_second(motion: Motion) -> int:
    """Return the playback speed, steps per second: real time if steps take time, otherwise an easy pace."""
    seconds = motion.seconds_per_step
    return PACE if seconds is None else min(max(1, round(1.0 / seconds)), FASTEST)
