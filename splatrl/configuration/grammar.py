"""Values and overrides in Hydra's grammar: written, read, nested."""

from collections.abc import Mapping, Sequence
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import QuotedString
from hydra.errors import HydraException


def quoted(value: object) -> str:
    """Quote any value for Hydra's grammar."""
    text = str(value).replace("'", "\\'")
    return f"'{text}'"


def written(value: object) -> str:
    """A plain value in Hydra's grammar: a number, a text, true, false, null, or a list or dictionary of them."""
    if isinstance(value, dict):
        return "{" + ",".join(f"{key}:{written(own)}" for key, own in value.items()) + "}"
    if isinstance(value, list):
        return f"[{','.join(map(written, value))}]"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return quoted(value) if isinstance(value, str) else repr(value)


def last_typed(overrides: Sequence[str], key: str, usual: object) -> Any:
    """The last value that was typed for a key, or the usual one.

    Raises:
        HydraException: for what is not in Hydra's grammar.
        ValueError: for a sweep, since what follows from the value stands before all jobs of one.
    """
    given = [override for override in overrides if override.startswith(f"{key}=")]
    if not given:
        return usual
    parsed = OverridesParser.create().parse_override(given[-1])
    if parsed.is_sweep_override():
        typed = given[-1].partition("=")[2]
        raise ValueError(f"{key}: expected one value, got {typed}; start a command for each, or trainings with -m")
    return unquoted(parsed.value())


def is_swept(overrides: Sequence[str], key: str) -> bool:
    """Whether the last value that was typed for a key is a sweep; what is not in Hydra's grammar is none."""
    given = [override for override in overrides if override.startswith(f"{key}=")]
    try:
        return bool(given) and OverridesParser.create().parse_override(given[-1]).is_sweep_override()
    except HydraException:
        return False


def unquoted(value: object) -> object:
    """A value that Hydra's grammar made: a quoted text as a plain one, all else as it is."""
    return value.text if isinstance(value, QuotedString) else value


def nested(flat: Mapping[str, Any]) -> str:
    """Dotted keys and their values as a dictionary in Hydra's grammar."""
    tree: dict[str, Any] = {}
    for key, value in flat.items():
        *parents, leaf = key.split(".")
        node = tree
        for parent in parents:
            node = node.setdefault(parent, {})
        node[leaf] = value
    return written(tree)
