"""The part of the page with which a person drives a robot and records demonstrations of a task."""

import queue
import threading
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from tensordict import TensorDictBase

from splatrl.envs.tasks.base import Outcome
from splatrl.envs.world import World
from splatrl.values import tenths
from splatrl.viewer.driver import Driver
from splatrl.viewer.goals import GoalsShown
from splatrl.viewer.keys import AGAIN, DISCARD, OTHER, input_script, keys_of
from splatrl.viewer.page import Page
from splatrl.viewer.robot import RobotShown, enlarged, words
from splatrl.viewer.takes import Takes

if TYPE_CHECKING:
    import viser

WAITING = 8
"""Maximum number of key presses that wait while the robot moves, as from a browser that renders slowly."""


class Driving:
    """Buttons and keys that drive one robot; while it moves, presses wait, and those beyond ``WAITING`` are dropped.

    Args:
        page: page to add the controls to.
        world: scene and task.
        seed: seed of starts and noise.
        takes: collects the successful episodes; None keeps none.
        wanted: number of episodes to keep.

    Raises:
        ValueError: for a task whose actions cannot be expressed by keys.
    """

    def __init__(self, page: Page, world: World, seed: int = 0, takes: Takes | None = None, wanted: int = 0):
        self.world, self.takes, self.wanted, self._turn = world, takes, wanted, page.turn
        server, keys = page.server, keys_of(world.task.motion)
        self.driver = Driver(world, seed, self._keep)
        self.finished = threading.Event()
        self._waiting, self._busy = queue.Queue[str](WAITING), threading.Lock()
        self.shown = RobotShown(server, "/robot", world.robot)
        driver, gui = self.driver, server.gui
        self.view = gui.add_image(enlarged(driver.pixels), label="what the robot sees")
        self.goals = GoalsShown(server, "/goals", world, common=takes is not None)
        self.status = gui.add_markdown("")
        self.keys: dict[str, Callable[[], None]] = {}
        for key in keys:
            self._offer(server, key.key, key.name, partial(driver.act, key.action))
        self._offer(server, AGAIN, "restart from the same start", driver.again)
        self._offer(server, OTHER, "another start", driver.begin)
        if takes is not None:
            self._offer(server, DISCARD, "discard the episode", self._discard)
            done = gui.add_button("save the kept episodes and stop")
            done.on_click(lambda _: self.finished.set())
        hint = " · ".join(f"**{key.key}** {key.name}" for key in keys)
        gui.add_markdown(f"Keys: {hint}. Arrow keys and a gamepad also drive; W A S D move the camera.")
        _run_script(server, input_script(world.task.motion))
        self._show()

    def press(self, key: str) -> bool:
        """Execute a key's function when its turn comes; return False if too many presses are waiting already."""
        try:
            self._waiting.put_nowait(key)
        except queue.Full:
            return False
        with self._busy, self._turn:
            self.keys[self._waiting.get_nowait()]()  # of the press that has waited longest, perhaps another thread's
            self._show()
        return True

    def _offer(self, server: "viser.ViserServer", key: str, name: str, do: Callable[[], None]) -> None:
        """Add a button, and a key that does the same."""
        self.keys[key] = do

        def pressed(_: object) -> None:
            self.press(key)

        server.gui.add_button(f"{name} ({key})").on_click(pressed)
        hotkey: Any = key
        server.gui.add_command(f"robot: {name}", hotkey=hotkey).on_trigger(pressed)

    def _keep(self, frames: TensorDictBase) -> None:
        if self.takes is not None and not self.finished.is_set():
            self.takes.add(frames)
            if self.wanted and len(self.takes.episodes) >= self.wanted:
                self.finished.set()

    def _discard(self) -> None:
        """Drop the running episode or, after a success or before the first step, the last one kept; begin another.

        Once the recording has ended, it does nothing.
        """
        if self.takes is None or self.finished.is_set():
            return
        if self.driver.succeeded or not self.driver.steps:
            self.takes.discard()
        self.driver.begin()

    def _show(self) -> None:
        driver = self.driver
        pose = self.world.task.motion.body_to_world(driver.state.cpu())[0]
        self.shown.show(pose, driver.pixels, driver.outcome, driver.steps == 0)
        self.view.image = enlarged(driver.pixels)
        said = "any key starts another episode" if driver.done else words(driver.outcome)
        result = f"**{words(driver.outcome)}**, {said}" if driver.done else said
        if driver.outcome is not Outcome.COLLISION and driver.free < 1:
            result = f"{result}, blocked"
        kept = "" if self.takes is None else f" · kept {len(self.takes.episodes)} of {self.wanted}"
        where = self.goals.show(driver.now)
        told = f"step {driver.steps} · return {tenths(driver.episode_return)} · {result}{kept}"
        self.status.content = f"{told}\n\n{where}" if where else told


def _run_script(server: "viser.ViserServer", source: str) -> None:
    """Run JavaScript in each open page; viser uses this message for plots, and has no other access to gamepads."""
    from viser import _messages

    server.gui._websock_interface.queue_message(_messages.RunJavascriptMessage(source=source))
