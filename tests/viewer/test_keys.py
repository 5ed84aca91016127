"""Keys of the viewer, and the actions that they stand for."""

import shutil
import subprocess
from unittest.mock import patch

import pytest
import torch
from torchrl.data import Bounded

from splatrl.motions import DriveMotion, ForwardMotion, LatticeMotion, NavigateMotion
from splatrl.motions.base import PlannedMotion
from splatrl.viewer.keys import input_script, keys_of


def test_a_walker_is_driven_by_four_keys() -> None:
    found = {key.key: (key.name, int(key.action)) for key in keys_of(ForwardMotion(0.4))}
    assert found == {"I": ("forward", 0), "K": ("back", 1), "J": ("left", 2), "L": ("right", 3)}


def test_a_lattice_has_keys_for_its_axes_and_spins() -> None:
    motion = LatticeMotion(0.4)
    found = keys_of(motion)
    assert [key.key for key in found] == ["I", "K", "J", "L", "U", "O"]
    assert [int(key.action) for key in found] == list(range(6))
    assert [key.name for key in found] == list(motion.action_names)


def test_a_driving_robot_has_keys_for_full_speed_turns_and_arcs() -> None:
    motion = DriveMotion(0.4)
    assert {"back, turning left", "back, turning right"} <= {key.name for key in keys_of(motion)}
    found = {key.key: key.action for key in keys_of(motion)}
    assert {"I", "J", "K", "L", "U", "O"} <= found.keys()
    ahead, left = motion.limits[1].tolist()
    assert found["I"].tolist() == pytest.approx([ahead, 0.0])
    assert found["U"].tolist() == pytest.approx([ahead, left])
    assert found["O"].tolist() == pytest.approx([ahead, -left])
    assert all(motion.action_spec.is_in(action) for action in found.values())
    assert len(found) == len(motion.actions())


def test_actions_that_no_path_is_planned_with_have_keys_too() -> None:
    found = {key.key: (key.name, int(key.action)) for key in keys_of(NavigateMotion(0.4))}
    assert found == {"1": ("stop", 0), "I": ("forward", 1), "J": ("left", 2), "L": ("right", 3)}


def test_the_actions_of_keys_are_within_the_action_spec() -> None:
    motion = DriveMotion(0.4)
    narrow = Bounded(low=-0.1, high=0.1, shape=(2,), dtype=torch.float32)
    with patch.object(DriveMotion, "action_spec", narrow):
        assert all(narrow.is_in(key.action) for key in keys_of(motion))


def test_actions_that_keys_cannot_express_are_refused() -> None:
    joints = Bounded(low=-1.0, high=1.0, shape=(12,), dtype=torch.float32)
    refused = pytest.raises(ValueError, match=r"expected actions that keys can express, .*, got 12 numbers per action")
    with patch.object(DriveMotion, "action_spec", joints), refused:
        keys_of(DriveMotion(0.4))


def test_actions_with_unknown_names_get_the_digits() -> None:
    motion = ForwardMotion(0.4)
    motion.action_names = ("jump", "forward", "duck", "roll")
    assert [(key.key, key.name) for key in keys_of(motion)] == [
        ("1", "jump"),
        ("I", "forward"),
        ("2", "duck"),
        ("3", "roll"),
    ]
    assert torch.equal(torch.stack([key.action for key in keys_of(motion)]), motion.actions())


PAGE = """
  const pressed = [], listeners = [];
  let tick, pads = [];
  globalThis.window = {addEventListener: (kind, do_) => listeners.push([kind, do_])};
  globalThis.KeyboardEvent = class { constructor(kind, rest) { Object.assign(this, rest); } };
  globalThis.document = {documentElement: {dispatchEvent: (event) => pressed.push(event.key)}};
  globalThis.setInterval = (do_) => { tick = do_; };
  Object.defineProperty(globalThis, "navigator", {value: {getGamepads: () => pads}, configurable: true});
  const pad = (axes, down = [], mapping = "standard") =>
    ({axes, mapping, buttons: Array.from({length: 16}, (_, n) => ({pressed: down.includes(n)}))});
  const type = (code, key, box, text, more) => { for (const [kind, do_] of listeners) if (kind === "keydown") do_({
    code, key, target: {closest: (what) => (what === "input" ? box : text) ? {} : null}, isTrusted: true,
    stopImmediatePropagation() { stopped += key; }, preventDefault() {}, ...more}); };
  let stopped = "", time = 1000;
  Object.defineProperty(globalThis, "performance", {value: {now: () => time}, configurable: true});
"""
"""A mock page with mock gamepads, in JavaScript."""


def keys_pressed(motion: PlannedMotion, acts: str) -> str:
    """Return the keys that the script presses while a page acts, if Node is there to run both."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs node, to run JavaScript")
    script = input_script(motion)
    code = [PAGE, script, script, acts, 'console.log(pressed.join(""));']
    return subprocess.run([node, "-e", "".join(code)], capture_output=True, text=True, check=True).stdout.strip()


def test_arrows_and_gamepads_press_the_same_keys() -> None:
    acts = """
      type("ArrowUp", "ArrowUp", false, false);
      type("ArrowLeft", "ArrowLeft", true, true);  // in a field for text
      type("KeyW", "w", false, false);  // the camera's
      type("KeyI", "i", false, false);  // viser hears it itself
      type("KeyK", "k", true, false);  // in a box that was ticked
      for (const [stick, down] of [[[0, -1], []], [[0.8, -0.8], []], [[0, 0], [0]], [[0, 0], [0]], [[0, 0], [1]]]) {
        pads = [null, pad(stick, down)];
        tick();
      }
    """
    assert keys_pressed(ForwardMotion(0.4), acts) == "ikiirx"
    assert keys_pressed(DriveMotion(0.4), acts) == "ikiorx"


def test_a_held_key_repeats_ten_times_a_second_and_every_press_counts() -> None:
    acts = """
      for (const [later, repeat] of [[0, false], [0, false], [30, true], [30, true], [50, true], [10, true]]) {
        time += later;
        type("ArrowUp", "ArrowUp", false, false, {repeat});
      }
      type("KeyK", "k", false, false, {repeat: true});  // kept from viser
      type("KeyK", "k", false, false, {});
      pressed.push(" ", stopped.slice(-2));
    """
    assert keys_pressed(ForwardMotion(0.4), acts) == "iii pk"


def test_shortcuts_of_the_browser_do_not_drive() -> None:
    acts = """
      type("KeyR", "r", true, false, {ctrlKey: true});
      type("ArrowLeft", "ArrowLeft", false, false, {altKey: true});
      pressed.push(stopped);
    """
    assert keys_pressed(ForwardMotion(0.4), acts) == ""


@pytest.mark.parametrize(
    ("pads", "ticks", "expected"),
    [
        ("pad([0, 0], [1]), pad([0, 0])", 3, "x"),  # a held button acts once, whatever another pad does
        ("pad([0, 0]), null, pad([0, 0], [0])", 3, "r"),
        ("pad([0, -1]), pad([0, -1])", 1, "i"),  # two pads make no two steps
        ("pad([0, -1]), pad([0, 0], [13])", 1, "i"),
        ("pad([0, -1], [1], ''), pad([0, 0])", 3, ""),  # its throttle may rest at −1
    ],
)
def test_several_gamepads_act_as_one_and_only_standard_ones_count(pads: str, ticks: int, expected: str) -> None:
    acts = f"for (let n = 0; n < {ticks}; n++) {{ pads = [{pads}]; tick(); }}"
    assert keys_pressed(ForwardMotion(0.4), acts) == expected
