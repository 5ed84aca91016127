"""Values of settings: checks of numbers and colours, keys of errors, words, formatting, and dotted keys."""

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from numbers import Integral
from typing import Any

MOST_SEED = 2**64 - 1
"""The largest seed that PyTorch's generators take."""


def require_number(
    name: str,
    value: object,
    low: float = -math.inf,
    high: float = math.inf,
    whole: bool = False,
    above: float | None = None,
    unit: str = "",
) -> None:
    """Refuse anything but a finite number in a range.

    Args:
        name: the key, for the message.
        value: the value that was given.
        low: smallest allowed value.
        high: largest allowed value.
        whole: whether the value must be an integer.
        above: bound that the value must exceed, instead of ``low``; None for no such bound.
        unit: the plural of the value's unit, such as "metres", for the message.

    Raises:
        ValueError: names the key, the range and what was given.
    """
    kinds = (int,) if whole else (int, float)
    right = isinstance(value, kinds) and not isinstance(value, bool) and low <= value <= high
    if right and (above is None or value > above) and abs(value) <= sys.float_info.max:  # type: ignore[operator, arg-type]
        return
    if above is not None:
        limit = f" above {above}" + ("" if high == math.inf else f", at most {high}")
    elif high == math.inf:
        limit = f", at least {low}" if unit else f" of at least {low}"
    else:
        limit = f" from {low} to {high}"
    kind = ("whole number" if whole else "number") + (f" of {unit}" if unit else "")
    raise ValueError(f"{name}: expected a {kind}{limit}, got {value!r:.80}")


def checked_seed(seed: object) -> int:
    """Return a seed as a Python integer, after refusing anything but a whole number of 64 bits with a ValueError."""
    value = int(seed) if isinstance(seed, Integral) and not isinstance(seed, bool) else seed  # NumPy's integers, too
    require_number("seed", value, 0, MOST_SEED, whole=True)
    assert isinstance(value, int)
    return value


def are_numbers(values: Any, count: int) -> bool:
    """Return whether something is a sequence of ``count`` finite numbers, not text or anything else in its place."""
    try:
        return len(values) == count and all(math.isfinite(value) for value in values)
    except (OverflowError, TypeError):  # a whole number beyond the largest float, or no number
        return False


def require_rgb(name: str, value: Sequence[float]) -> None:
    """Refuse anything but a colour of three numbers in [0, 1].

    Args:
        name: the key, for the message.
        value: the value that was given.

    Raises:
        ValueError: names the key and what was given.
    """
    if len(value) != 3 or not all(isinstance(one, int | float) and 0.0 <= one <= 1.0 for one in value):
        raise ValueError(f"{name}: expected red, green and blue in [0, 1], got {list(value)}")


@contextmanager
def under_key(key: str) -> Iterator[None]:
    """Prefix a ``ValueError`` raised in the block with a config key."""
    try:
        yield
    except ValueError as error:
        if str(error).startswith(f"{key}."):  # it already names the key
            raise
        raise ValueError(f"{key}: {error}") from error


def split_words(text: str) -> list[str]:
    """Split a text into words at blanks and commas."""
    return text.replace(",", " ").split()


def tenths(value: float) -> str:
    """Format a number for display with one decimal; a value that rounds to zero has no sign."""
    return f"{round(value, 1) + 0.0:.1f}"


def flat(node: Mapping[str, Any], place: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted keys of nested settings with their values; an empty mapping counts as a value.

    Args:
        node: nested keys and values.
        place: dotted key of ``node`` itself.
    """
    for key, value in node.items():
        name = f"{place}.{key}" if place else str(key)
        if isinstance(value, Mapping) and value:
            yield from flat(value, name)
        else:
            yield name, value


def one_line(message: BaseException | Warning | str) -> str:
    """Return a message as one line; the name of its kind where an error has none.

    Letters that cannot be printed, such as those with which a name in a file would control the terminal, are escaped.
    """
    text = " ".join(str(message).split()) or type(message).__name__
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)
