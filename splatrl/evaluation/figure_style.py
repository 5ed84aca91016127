"""Colours, marks and resolution shared by all figures, and how a figure is saved."""

import itertools
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager, get_font
from matplotlib.text import Text
from PIL import ImageFont

from splatrl.envs.tasks.base import Mark
from splatrl.files import replacing

REACHED, PARTLY, MISSED = "#009e73", "#e69f00", "#d55e00"  # distinguishable with any colour vision
GOAL, TEST, BLUE, PURPLE, INK = "#e0409f", "#f0e442", "#0072b2", "#8a5a99", "#222222"
MARKS = ((GOAL, 0), (TEST, 4), ("#56b4e9", 3))
"""Colour and number of corners (0 is a dot) of marks, assigned to their names in order of first appearance."""
OWN_FONT = "DejaVu Sans"
"""Font family that ships with matplotlib; its other one, Last Resort, has placeholders only."""
LONGEST = 48
"""Length of a name up to which a figure shows all of it."""
DPI = 160
"""Resolution of saved figures, dots per inch."""


def mark_styles(marks: Iterable[Mark]) -> dict[str, tuple[str, int]]:
    """Assign a look to the marks of each name: colour and number of corners."""
    names = dict.fromkeys(mark.name for mark in marks)
    return dict(zip(names, itertools.cycle(MARKS)))


def legible(name: str) -> str:
    """Return a name for a figure, in which letters that no installed font has are replaced by their escapes.

    The middle of a long one, which would leave no room for what the figure shows, is left out.
    """
    text = "".join(letter if _family(letter) else letter.encode("unicode_escape").decode() for letter in name)
    return text if len(text) <= LONGEST else f"{text[: LONGEST // 2]}…{text[1 - LONGEST // 2 :]}"


@cache
def _family(letter: str) -> str | None:
    """Return a font family that has a letter, matplotlib's own if it does; None if no installed family has it."""
    if _has(OWN_FONT, letter):
        return OWN_FONT
    code = ord(letter)
    others = (font for font in fontManager.ttflist if not font.name.startswith((OWN_FONT, "Last Resort")))
    return next((font.name for font in others if get_font(font.fname).get_char_index(code)), None)


def font(size: int, words: str = "") -> ImageFont.FreeTypeFont:
    """Load a font for Pillow: matplotlib's own, or an installed one that has more letters of some words."""
    families = dict.fromkeys([OWN_FONT, *filter(None, map(_family, words))])
    if len(families) == 1:
        return _loaded(OWN_FONT, size)
    return _loaded(max(families, key=lambda family: sum(_has(family, letter) for letter in words)), size)


@cache
def _loaded(family: str, size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(fontManager.findfont(family), size)


def _has(family: str, letter: str) -> bool:
    return bool(get_font(fontManager.findfont(family)).get_char_index(ord(letter)))


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure atomically, in the format that the suffix of its path names.

    Letters that matplotlib's own font lacks are drawn in an installed font that has them.
    """
    FigureCanvasAgg(figure)
    for words in figure.findobj(Text):
        families = dict.fromkeys(filter(None, map(_family, words.get_text())))
        if families.keys() - {OWN_FONT}:
            words.set_fontfamily(list({OWN_FONT: None} | families))
    with replacing(path) as stream:
        figure.savefig(stream, format=path.suffix.removeprefix("."), bbox_inches="tight")
