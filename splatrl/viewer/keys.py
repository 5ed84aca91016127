"""Key bindings: the actions of a motion on a keyboard or a gamepad."""

import json
from dataclasses import dataclass

import torch
from torch import Tensor

from splatrl.motions.base import PlannedMotion

NAMES = {
    "forward": "I",
    "back": "K",
    "left": "J",
    "right": "L",
    "+x": "I",
    "-x": "K",
    "+y": "J",
    "-y": "L",
    "+spin": "U",
    "-spin": "O",
}
"""Keys of discrete actions, by the action's name; actions not listed here get the digits, in order."""
SPEEDS = {
    (1, 0): ("I", "forward"),
    (-1, 0): ("K", "back"),
    (0, 1): ("J", "turn left"),
    (0, -1): ("L", "turn right"),
    (1, 1): ("U", "forward, left"),
    (1, -1): ("O", "forward, right"),
    (-1, 1): ("", "back, turning left"),
    (-1, -1): ("", "back, turning right"),
}
"""Keys and names of continuous actions, by the signs of their linear and angular velocity; no key means a digit."""
AGAIN, OTHER, DISCARD = "R", "N", "X"


@dataclass(frozen=True)
class Key:
    """A key and its action.

    Attributes:
        key: a capital letter or a digit.
        name: name of the action.
        action: action of a single robot, as in the motion's ``action_spec``.
    """

    key: str
    name: str
    action: Tensor


def keys_of(motion: PlannedMotion) -> list[Key]:
    """Return the keys that drive a robot.

    Args:
        motion: the robot's motion. If its actions are continuous, the keys select from its ``actions()``, the ones that
            paths are made of.

    Raises:
        ValueError: if the continuous actions differ in shape from those of paths, such as those of twelve joints.
    """
    if motion.action_names:
        actions = torch.arange(len(motion.action_names))  # including those that paths do not use, such as stop
        named = [(NAMES.get(name, ""), name) for name in motion.action_names]
    else:
        actions, wanted = motion.actions().cpu(), motion.action_spec.shape
        if actions.shape[1:] != wanted:
            numbers = f"{wanted.numel()} numbers"
            raise ValueError(
                f"task: expected actions that keys can express, a speed and a turn, got {numbers} per action"
            )
        actions = motion.action_spec.cpu().project(actions)
        signs = [tuple(row) for row in torch.sign(actions).int().tolist()]
        words = [" ".join(f"{value:.3g}" for value in row) for row in actions.tolist()]
        named = [SPEEDS.get(sign, ("", word)) for sign, word in zip(signs, words, strict=True)]
    digits = iter("1234567890")
    found = [Key(key or next(digits, ""), name, action) for (key, name), action in zip(named, actions, strict=True)]
    return [key for key in found if key.key]


def input_script(motion: PlannedMotion) -> str:
    """Return JavaScript that maps arrow keys and gamepads to the keys: stick and D-pad drive, A is R, B is X.

    viser turns keys into messages itself, but arrow keys would move its camera, and while a clicked checkbox has the
    focus, keys would count as text input. A held key repeats at most ten times a second, as a gamepad does: otherwise
    a browser that renders slowly would send all its repeats at once. The script is run once in each page.
    """
    used = [key.lower() for key in (*(key.key for key in keys_of(motion)), AGAIN, OTHER, DISCARD)]
    bends = "false" if motion.action_names else "true"
    return _SCRIPT.replace("USED", json.dumps(used)).replace("BENDS", bends)


_SCRIPT = """
if (!window.splatrlInput) {
  window.splatrlInput = true;
  const used = USED, bends = BENDS;
  const arrows = {ArrowUp: "i", ArrowDown: "k", ArrowLeft: "j", ArrowRight: "l"};
  const press = (key) => document.documentElement.dispatchEvent(
    new KeyboardEvent("keydown", {key: key, code: "Key" + key.toUpperCase(), bubbles: true}));
  const TEXT = "input:not([type=checkbox]), textarea, select, [contenteditable], [role=slider]";
  const within = (target, what) => target.closest && target.closest(what);
  let last = 0;
  for (const kind of ["keydown", "keyup"]) window.addEventListener(kind, (event) => {
    if (!event.isTrusted || event.ctrlKey || event.metaKey || event.altKey) return;  // the browser's, such as Ctrl+R
    const key = arrows[event.code] || event.key;
    if (!used.includes(key) || within(event.target, TEXT)) return;
    const early = event.repeat && performance.now() - last < 100;
    const taken = arrows[event.code] || within(event.target, "input");  // a box that was ticked would keep the key
    if (kind === "keydown" && !early) last = performance.now();
    if (!taken && !early) return;
    event.stopImmediatePropagation();
    event.preventDefault();
    if (kind === "keydown" && !early) press(key);
  }, true);
  const held = {};
  const once = (name, down, key) => { if (down && !held[name]) press(key); held[name] = down; };
  setInterval(() => {  // several gamepads act as one; only of standard ones is it known what rests at 0
    const pads = [...navigator.getGamepads()].filter((pad) => pad && pad.mapping === "standard");
    const down = (number) => pads.some((pad) => pad.buttons[number] && pad.buttons[number].pressed);
    const pushed = (axis, sign) => pads.some((pad) => sign * pad.axes[axis] > 0.5);
    const ahead = pushed(1, -1) || down(12), back = pushed(1, 1) || down(13);
    const left = pushed(0, -1) || down(14), right = pushed(0, 1) || down(15);
    const bend = ahead && left ? "u" : ahead && right ? "o" : "";
    const turn = down(4) ? "u" : down(5) ? "o" : "";
    const straight = ahead ? "i" : back ? "k" : left ? "j" : right ? "l" : "";
    const key = bends ? bend || straight : turn || straight;
    if (used.includes(key)) press(key);
    once("again", down(0), "r");
    once("discard", down(1), "x");
  }, 100);
}
"""
