"""Writing, reading and nesting values and overrides in Hydra's override grammar."""

import functools
import re
from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import QuotedString, Sweep
from hydra.errors import HydraException

from splatrl.files import expanded

NEW = ("out", "record", "folder", "hydra.run.dir", "hydra.sweep.dir")
"""Keys of paths to which something is written, and which need not exist yet; none takes several."""
HOME = re.compile(r"(?:(?<=[=\[,:'\"])|(?<=[\[,:] ))~(?=/|$)")
"""The tilde at the beginning of a path in an override."""
POWERS = re.compile(r"\d+(?:\.\d*)?[eE]\+?\d\d?")
"""A number such as 1e6, which may be whole although Hydra reads a float."""


@functools.cache
def overrides_parser() -> OverridesParser:
    """Return Hydra's parser of overrides, made once: making it takes longer than parsing a short word."""
    return OverridesParser.create()


def readable(word: str) -> str:
    """Return an override in Hydra's grammar, with ``~`` at the beginning of paths replaced by the home directory.

    Text that the grammar does not know, such as a path with an umlaut or parentheses, is quoted if it exists as a path,
    or if it contains none of the characters that have a meaning there. The path of an output is quoted even if it reads
    as a list or as several values. Whole numbers may have exponents, as in 1e6, which Hydra reads as a float and counts
    refuse. Options, such as ``--cfg``, stay as they are.
    """
    if word.startswith("-"):
        return word
    word = HOME.sub(lambda _: str(expanded("~")), word)
    key, equals, value = word.partition("=")
    if key not in NEW:
        value = ",".join(map(_whole, value.split(",")))
        word = f"{key}{equals}{value}"
    path = key in NEW and not value.startswith(("'", '"'))
    try:
        several = isinstance(overrides_parser().parse_override(word).value(), Sweep | list | dict)
        misread = path and several
    except HydraException:
        misread = path or Path(value).exists() or not set("[]{}'\",").intersection(value)
    return f"{key}={quoted(value)}" if equals and misread else word


def _whole(number: str) -> str:
    """Write a whole number such as 1e6 without its exponent; return anything else unchanged."""
    if not POWERS.fullmatch(number) or (exact := Decimal(number)) != int(exact):
        return number
    return str(int(exact))


def quoted(value: object) -> str:
    """Quote any value for Hydra's grammar."""
    text = str(value).replace("'", "\\'")
    return f"'{text}'"


def bare(text: str) -> str:
    """Return the text of a value without its quotes, if it has any."""
    quote = text[:1]
    if len(text) > 1 and quote in ("'", '"') and text.endswith(quote):
        return text[1:-1].replace(f"\\{quote}", quote)
    return text


def written(value: object) -> str:
    """Write a plain value in Hydra's grammar: a number, string, boolean, None, or a list or dictionary of these."""
    if isinstance(value, dict):
        return "{" + ",".join(f"{key}:{written(own)}" for key, own in value.items()) + "}"
    if isinstance(value, list):
        return f"[{','.join(map(written, value))}]"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return quoted(value) if isinstance(value, str) else repr(value)


def last_typed(overrides: Sequence[str], key: str, usual: object) -> Any:
    """Return the last value that was typed for a key, or the default.

    Args:
        overrides: overrides in Hydra's grammar.
        key: the key.
        usual: the default.

    Raises:
        HydraException: for an override that is not in Hydra's grammar.
        ValueError: for a sweep, because what is derived from the value would apply to all jobs of the sweep.
    """
    given = [override for override in overrides if override.startswith(f"{key}=")]
    if not given:
        return usual
    parsed = overrides_parser().parse_override(given[-1])
    if parsed.is_sweep_override():
        typed = given[-1].partition("=")[2]
        raise ValueError(
            f"{key}: expected one value, got {typed}; run the command once per value, or sweep trainings with -m"
        )
    return unquoted(parsed.value())


def unquoted(value: object) -> object:
    """Turn a quoted string from Hydra's parser into a plain one; return any other value unchanged."""
    return value.text if isinstance(value, QuotedString) else value


def nested(flat: Mapping[str, Any]) -> str:
    """Write dotted keys and their values as a nested dictionary in Hydra's grammar."""
    tree: dict[str, Any] = {}
    for key, value in flat.items():
        *parents, leaf = key.split(".")
        node = tree
        for parent in parents:
            node = node.setdefault(parent, {})
        node[leaf] = value
    return written(tree)
