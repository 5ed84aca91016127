"""Captions of videos of episodes: what is known at each step, in columns wide enough for whatever they will show."""

from collections.abc import Callable, Iterator, Sequence

from PIL import Image, ImageDraw
from torch import Tensor

from splatrl.envs.tasks import Outcome
from splatrl.evaluation.chart import COLORS
from splatrl.evaluation.figure_style import font
from splatrl.evaluation.recording import Recording
from splatrl.values import tenths

STRIP, GAP = 60, 16
"""Height of a caption and least space between its columns, pixels."""
LARGEST, READABLE, SMALLEST = 18, 12, 8
"""Sizes of values: the largest, the smallest with a column for each number of an action, and the smallest at all."""
BADGE = 16
"""Largest size of the outcome, which is written on a badge that extends ``PAD`` pixels beyond it."""
PAD = 6

Facts = list[tuple[str, str]]
"""Names and values, from left to right."""
Style = Callable[[Tensor, Sequence[str]], Facts]
"""How an action is written, given its names."""


class Captions:
    """Captions of all steps of some episodes, whose columns have the same place in each of them.

    Each number of a continuous action has a column under its name, or all share one where the page is too narrow.

    Args:
        recordings: the episodes.
        action_names: names of discrete actions, by index, or of the numbers of a continuous one; empty for numbers
            without names.
        goals: number of goals needed for success, if episodes can have several.
        width: width of the page, pixels.
    """

    def __init__(self, recordings: Sequence[Recording], action_names: Sequence[str], goals: int | None, width: int):
        self.ends = [recording.outcome for recording in recordings]
        for style, least in ((_apart, READABLE), (_together, SMALLEST), (_counted, SMALLEST)):
            self.episodes = list(_episodes(recordings, style, action_names, goals))
            for self.size in range(LARGEST, least - 1, -1):
                widths = self._widths()
                spare = width - sum(widths) - GAP * (len(widths) + 1)
                if spare >= 0:
                    break
            else:
                continue
            break
        apart = GAP + spare / len(widths)
        self.lefts = [GAP + sum(widths[:column]) + apart * column for column in range(len(widths))]

    def write(self, page: Image.Image, episode: int, step: int) -> None:
        """Write the caption of a step at the bottom of a page, with the outcome of the last step on a badge."""
        pen, top = ImageDraw.Draw(page), page.height - STRIP + 4
        facts, left = self.episodes[episode][step], self.lefts[-1]
        last = step == len(self.episodes[episode]) - 1
        outcome = self.ends[episode] if last else Outcome.RUNNING
        for place, (name, value) in zip(self.lefts, [*facts, ("outcome", "")], strict=True):
            pen.text((place, top + 9), name, fill="#aaaaaa", font=font(self._small, name), anchor="ls")
            pen.text((place, top + 36), value, fill="white", font=font(self.size, value), anchor="ls")
        words, letters = _words(outcome), font(min(self.size, BADGE))
        if last:
            box = (left - PAD, top + 17, left + letters.getlength(words) + PAD, top + 44)
            pen.rounded_rectangle(box, 5, fill=COLORS[outcome])
        pen.text((left, top + 30), words, fill="white", font=letters, anchor="lm")

    def _widths(self) -> list[float]:
        """Return the widths of the columns, the outcome's last."""
        columns: list[float] = []
        for column in zip(*(facts for steps in self.episodes for facts in steps), strict=True):
            values = {value for _, value in column}
            columns.append(max(_length(column[0][0], self._small), *(_length(value, self.size) for value in values)))
        words = map(_words, {Outcome.RUNNING, *self.ends})
        badge = PAD + max(_length(word, min(self.size, BADGE)) for word in words)
        return [*columns, max(_length("outcome", self._small), badge)]

    @property
    def _small(self) -> int:
        """Size of names."""
        return max(SMALLEST, 2 * self.size // 3)


def _episodes(
    recordings: Sequence[Recording], style: Style, names: Sequence[str], goals: int | None
) -> Iterator[list[Facts]]:
    """Yield the facts of each step of each episode; before the first step, there is no action."""
    for number, recording in enumerate(recordings, 1):
        taken = [style(action, names) for action in recording.action]
        steps = []
        for step, action in enumerate([[(name, "–") for name, _ in taken[0]], *taken]):
            facts = [("episode", f"{number} of {len(recordings)}"), ("step", str(step)), *action]
            facts.append(("return", tenths(float(recording.episode_return[step]))))
            if recording.goals is not None:
                facts.append(("goals", f"{int(recording.goals[step])} of {goals}"))
            steps.append(facts)
        yield steps


def _apart(action: Tensor, names: Sequence[str]) -> Facts:
    if not (names and action.is_floating_point()):
        return _together(action, names)
    return list(zip(names, map(_number, action.flatten().tolist()), strict=True))


def _together(action: Tensor, names: Sequence[str]) -> Facts:
    if names and not action.is_floating_point():
        return [("action", names[int(action)])]
    return [("action", " ".join(map(_number, action.flatten().tolist())))]


def _counted(action: Tensor, names: Sequence[str]) -> Facts:
    return [("action", f"{action.numel()} numbers")] if action.is_floating_point() else _together(action, names)


def _number(value: float) -> str:
    """Format a number with two decimals; one that rounds to zero has no sign."""
    return f"{round(value, 2) + 0.0:.2f}"


def _words(outcome: Outcome) -> str:
    return outcome.name.replace("_", " ").lower()


def _length(words: str, size: int) -> float:
    return font(size, words).getlength(words)
