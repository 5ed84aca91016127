"""The part of the page in which goal, object and corners are moved, previewed, and saved to ``scene.yaml``."""

import math
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from splatrl.envs.world import World
from splatrl.geometry import axis_rotations, quats_to_rotations, rigid, yaw_quat
from splatrl.scenes.description import SCENE_FILE, read_description
from splatrl.scenes.editing import edit_description
from splatrl.viewer.markdown import plain
from splatrl.viewer.page import Page
from splatrl.viewer.place import CORNERS, Handle, changes, dragged, handles, listed, numbers_of, typed

if TYPE_CHECKING:
    import viser

THUMBNAIL = 320
"""Height of the preview of a robot's view at the goal, pixels."""
NUMBERS = {"goal": "x, y (m), yaw (°)", "object": "x, y, z (m)", "walk": "x, y (m)", "bounds": "x, y, z (m)"}
"""What the numbers of a handle are, for the label of its input field."""


class Placing:
    """Handles over the splats, input fields with their values, and a button that saves them.

    Args:
        page: page to add the controls to.
        world: scene, robot and task.
        values: ``goal``, ``object``, ``walk`` and ``bounds``, as in a ``scene.yaml``; None for those without a value.
        folder: the scene's folder; None for a scene without one, which cannot be saved.
        check: called with the whole content of the new ``scene.yaml``; raises a ``ValueError`` if it is inconsistent.
    """

    def __init__(
        self,
        page: Page,
        world: World,
        values: Mapping[str, Any],
        folder: Path | None = None,
        check: Callable[[Mapping[str, Any]], object] = lambda stated: None,
    ):
        self.page, self.world, self.folder, self.check = page, world, folder, check
        self.saved, self.values = dict(values), dict(values)
        self._stated = {} if folder is None else read_description(folder)
        self.height = world.robot.height
        self._lock, self._looks = threading.Lock(), threading.Lock()
        self.controls: dict[str, viser.TransformControlsHandle] = {}
        self.fields: dict[str, viser.GuiTextHandle] = {}
        gui, found = page.server.gui, handles(self.values, self.height)
        for handle in found:
            self._control(handle)
        for handle in found:
            if handle.name.partition(" ")[0] not in CORNERS:
                self._field(handle.name)
        if values.get("goal") is not None:
            self.view = gui.add_image(self._seen(), label="what a robot sees at the goal")
        for key in CORNERS:
            if values.get(key) is not None:
                self._switch(key)
        self.status = gui.add_markdown(
            "" if folder is not None else "Only scenes in a folder, with a `scene.yaml`, can be saved."
        )
        self.button = gui.add_button(f"save to {SCENE_FILE}", disabled=folder is None)

        @self.button.on_click
        def save(_: object) -> None:
            self.save()

    def drag(self, handle: Handle) -> None:
        """Adopt the new position of a handle, unless it is not finite, as when dragged to the horizon."""
        if not all(map(math.isfinite, (*handle.position, handle.yaw))):
            return
        step = self.world.task.motion.step
        with self._lock:
            self.values = dragged(self.values, handle, step)
        text = listed(numbers_of(self.values, handle.name))
        setattr(self.fields[handle.name], "value", text)  # noqa: B010 - typed as read-only
        self._follow(handle.name)

    def enter(self, name: str, text: str) -> None:
        """Adopt what is being typed for a handle as soon as it can be read; the text itself is left alone."""
        try:
            with self._lock:
                self.values = typed(self.values, name, text)
        except ValueError as error:
            self.status.content = plain(error)
            return
        handle = next(handle for handle in handles(self.values, self.height) if handle.name == name)
        self.controls[name].position, self.controls[name].wxyz = handle.position, yaw_quat(handle.yaw)
        self._follow(name)

    def save(self) -> bool:
        """Write the changes to the folder's ``scene.yaml``, report the result on the page, and return the success."""
        if self.folder is None:
            return False
        with self._lock:
            try:
                for name, field in self.fields.items():
                    typed(self.values, name, field.value)  # refuses a text that cannot be read
                changed = changes(self.saved, self.values)
                if changed:
                    self._require_unchanged(self.folder, changed)
                    edit_description(self.folder, changed, self.check)
                    self._stated = read_description(self.folder)
                self.saved |= changed
            except (ValueError, OSError) as error:
                self.status.content = f"**not saved**: {plain(error)}"
                return False
        self.status.content = f"saved {', '.join(changed)}" if changed else "nothing to save"
        return True

    def _require_unchanged(self, folder: Path, keys: Iterable[str]) -> None:
        """Refuse to overwrite changes that somebody else made since the page was opened or last saved."""
        now = read_description(folder)
        others = [f"{key}: {now.get(key)}" for key in keys if now.get(key) != self._stated.get(key)]
        if others:
            raise ValueError(
                f"{SCENE_FILE} has been changed in the meantime ({', '.join(others)}); start splatrl-view again"
            )

    def _follow(self, name: str) -> None:
        """Update the lines and the status for a handle that has moved."""
        key = name.partition(" ")[0]
        value = self.values[key]
        if key == "bounds" and all(low < high for low, high in zip(*value, strict=True)):
            self.page.move_bounds(value)
        solid = key == "goal" and bool(self.world.checker.collides(self._goal_pose())[0])
        free = " · a robot would collide at the goal" if solid else ""
        self.status.content = f"not saved yet: {', '.join(changes(self.saved, self.values)) or 'nothing'}{free}"

    def look(self, wait: bool = True) -> None:
        """Update the preview of the view at the goal.

        Args:
            wait: whether to wait for a preview that is being drawn; otherwise this update is skipped.
        """
        if self._looks.acquire(blocking=wait):
            try:
                self.view.image = self._seen()
            finally:
                self._looks.release()

    def _goal_pose(self) -> torch.Tensor:
        x, y, yaw_deg = self.values["goal"]
        turn = axis_rotations(2, torch.tensor(math.radians(yaw_deg)))
        return rigid(turn, torch.tensor([x, y, self.height])).unsqueeze(0).to(self.world.device)

    def _seen(self) -> Any:
        """Render what a robot's camera sees at the goal: [H, W, 3] uint8."""
        robot = self.world.robot
        wide = max(1, round(THUMBNAIL * robot.image_width / robot.image_height))
        cameras = replace(robot, image_width=wide, image_height=THUMBNAIL).cameras(self._goal_pose())
        with self.page.turn:
            return self.world.drawing.renderer.pixels(cameras)[0].cpu().numpy()

    def _field(self, name: str, visible: bool = True) -> None:
        """Add an input field for the numbers of a handle.

        It takes text, since the number fields of viser 1.1.1 drop the minus sign of -0.5 while it is being typed.
        """
        label, text = f"{name}: {NUMBERS[name.partition(' ')[0]]}", listed(numbers_of(self.values, name))
        field = self.page.server.gui.add_text(label, text, visible=visible)
        self.fields[name] = field

        @field.on_update
        async def changed(event: Any) -> None:  # one after the other, as the keys are pressed
            if event.client is not None:  # otherwise set by the server, to follow a handle
                self.enter(name, field.value)

        if name == "goal":

            @field.on_update
            def seen(event: Any) -> None:
                if event.client is not None:
                    self.look()

    def _switch(self, key: str) -> None:
        """Add a checkbox that shows the handles of ``walk`` or ``bounds``, hidden at first since they cover a lot."""
        box = self.page.server.gui.add_checkbox(f"move {key}", False)
        names = [name for name in self.controls if name.startswith(f"{key} ")]
        for name in names:
            self._field(name, visible=False)

        @box.on_update
        def toggle(_: object) -> None:
            for name in names:
                self.controls[name].visible = self.fields[name].visible = box.value

    def _control(self, handle: Handle) -> None:
        key = handle.name.partition(" ")[0]
        flat, turns = key in ("goal", "walk"), key == "goal"
        control = self.page.server.scene.add_transform_controls(
            f"/place/{handle.name.replace(' ', '_')}",
            scale=0.5,
            line_width=4.0,
            active_axes=(True, True, not flat),
            disable_rotations=not turns,
            position=handle.position,
            wxyz=yaw_quat(handle.yaw),
            visible=key not in CORNERS,
        )
        self.page.server.scene.add_label(f"{control.name}/label", handle.name)
        self.controls[handle.name] = control

        @control.on_update
        async def moved(_: object) -> None:
            x, y, z = (float(value) for value in control.position)
            self.drag(Handle(handle.name, (x, y, z), _yaw(control.wxyz)))

        if key == "goal":

            @control.on_update
            def seen(event: Any) -> None:  # in its own thread, so that dragging stays smooth
                self.look(event.phase == "end")


def _yaw(wxyz: Any) -> float:
    rotation = quats_to_rotations(torch.tensor(np.array(wxyz), dtype=torch.float64).unsqueeze(0))[0]
    return math.atan2(float(rotation[1, 0]), float(rotation[0, 0]))
