"""The part of the page that shows a trained policy at work."""

import threading

import torch
from tensordict import TensorDict, TensorDictBase

from splatrl.envs.tasks.base import Outcome
from splatrl.evaluation.rollouts import acting
from splatrl.evaluation.starts import spread
from splatrl.runs import TrainedPolicy
from splatrl.viewer.goals import GoalsShown
from splatrl.viewer.page import Page
from splatrl.viewer.robot import RobotShown, enlarged, words

STARTS = 64
"""Number of starts for the episodes shown, evenly spaced over the start set."""
HOLD = 1.0
"""Seconds for which the end of an episode stays on screen."""
TURN = 25
"""Stride through the ``STARTS`` from one episode to the next: all get shown, and successive ones are far apart."""


class Rollout:
    """Plays episodes of a policy, one after another, in a separate thread.

    Args:
        page: page to add the robot and the controls to.
        trained: policy and world, with one scene.
        seed: seed for sampling actions.
    """

    def __init__(self, page: Page, trained: TrainedPolicy, seed: int = 0):
        self.trained, self.seed, self._turn = trained, seed, page.turn
        server = page.server
        self.world = trained.world.worlds[0]
        self.env = self.world.env(1)
        plan = self.world.plan
        self.starts = plan.states[spread(plan.start_rows, STARTS)]
        self.episodes = self.successes = 0
        self._stop = threading.Event()
        self.shown = RobotShown(server, "/policy", self.world.robot)
        blank = torch.zeros(self.world.robot.image_height, self.world.robot.image_width, 3, dtype=torch.uint8)
        self.view = server.gui.add_image(enlarged(blank), label="what the robot sees")
        self.goals = GoalsShown(server, "/policy_goals", self.world)
        self.status = server.gui.add_markdown("")
        self.plays = server.gui.add_checkbox("play", True)
        self.speed = server.gui.add_slider("steps per second", 1, 30, 1, 6)
        self.sampled = server.gui.add_checkbox(
            "sampled", True, hint="sample actions from the policy; otherwise take the most likely one"
        )
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Start playing."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout=2 * HOLD)

    def _run(self) -> None:
        number = 0
        while not self._stop.is_set():
            self.episode(number)
            number += 1
            self._stop.wait(HOLD)

    def episode(self, number: int) -> Outcome:
        """Show one episode, whose number decides its start; return its outcome, or RUNNING if it was stopped."""
        policy, motion = self.trained.policy, self.world.task.motion
        state = self.starts[[number * TURN % len(self.starts)]]
        with acting(bool(self.sampled.value), self.seed + number, self.env.device):
            given = TensorDict({"state": state}, [1], device=self.env.device)
            with self._turn:
                now = self.env.reset(given, set_state=True)
            outcome, step = Outcome.RUNNING, 0
            while not self._stop.is_set():
                self._show(motion.body_to_world(now["state"].cpu())[0], now, outcome, step)
                if outcome is not Outcome.RUNNING:
                    break
                self._wait()
                with self._turn:
                    after = self.env.step(policy(now))
                if after["next", "done"].item():
                    outcome = Outcome(int(after["next", "outcome"]))
                    self.episodes += 1
                    self.successes += bool(after["next", "success"])
                now, step = self.env.step_mdp(after), step + 1
        return outcome

    def _wait(self) -> None:
        self._stop.wait(1.0 / self.speed.value)
        while not self.plays.value and not self._stop.is_set():
            self._stop.wait(0.1)

    def _show(self, body_to_world: torch.Tensor, now: TensorDictBase, outcome: Outcome, step: int) -> None:
        pixels = now["pixels"][0, ..., -3:]
        self.shown.show(body_to_world.cpu(), pixels.cpu(), outcome, step == 0)
        self.view.image = enlarged(pixels)
        rate = f" · {self.successes} of {self.episodes} episodes succeeded" if self.episodes else ""
        where, told = self.goals.show(now), f"step {step} · **{words(outcome)}**{rate}"
        self.status.content = f"{told}\n\n{where}" if where else told
