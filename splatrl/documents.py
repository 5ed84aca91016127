"""YAML and JSON: read from untrusted files as plain values of limited size, and written atomically."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from splatrl.files import replacing

MAX_YAML = 128 * 2**10
"""Maximum size of a YAML file in bytes, ten times that of the files that splatrl writes."""
MAX_JSON = 64 * 2**20
"""Maximum size of a JSON file in bytes, enough for the poses of a capture of thousands of images."""
MAX_NESTS = 2**21
"""Maximum number of lists and objects in a JSON text: an empty one is two bytes of text, but 64 bytes of memory."""
MAX_DEPTH = 32
FAST: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""PyYAML's parser in C, ten times as fast, or the one in Python where PyYAML was built without it. It checks ASCII
texts alone: a byte order mark in a text hides aliases from it, and not from the other, with which OmegaConf reads."""
INVALID = (yaml.YAMLError, OmegaConfBaseException, AssertionError, RecursionError, ValueError, TypeError, LookupError)
"""What PyYAML and OmegaConf raise for a text that is not YAML or cannot be plain values."""
TAGS = "tag:yaml.org,2002:"
PLAIN = ("!", *(TAGS + kind for kind in ("null", "bool", "int", "float", "str", "seq", "map")))
"""The tags of plain values; ``!`` stands for text, or a plain list or mapping."""
REFERENCE = re.compile(r"\$\{[\w.]+\}")
"""A reference to another key, such as ${robot.height}: the entire value, so that nothing grows, and no resolver."""


def read_yaml(path: Path, limit: int = MAX_YAML) -> Any:
    """Read a YAML file as plain values; aliases are refused, because a few of them can expand to gigabytes.

    Args:
        path: path of the file.
        limit: maximum size of the file in bytes.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for a file that is too large, nested too deeply or not YAML, or that uses aliases, or tags of other
            than plain values.
    """
    return _read(path, limit)[1]


def read_config(path: Path) -> DictConfig:
    """Read a YAML file whose values may refer to its other keys (``${robot.height}``).

    Resolvers, which could read the environment or create nodes, are refused.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for anything that ``read_yaml`` refuses, for a resolver, or for a file that is not a mapping.
    """
    config, content = _read(path, MAX_YAML)
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected keys and values, got {content!r:.80}")
    for text in _texts(content):
        if "${" in text and not REFERENCE.fullmatch(text):
            raise ValueError(f"{path}: expected references to a single key such as ${{robot.height}}, got {text:.80}")
    return config


def _read(path: Path, limit: int) -> tuple[Any, Any]:
    """Read a YAML file as a config and as plain values."""
    text = _text(path, limit)
    try:
        try:
            _check_events(text, FAST if text.isascii() else yaml.SafeLoader)
        except yaml.YAMLError:
            _check_events(text, yaml.SafeLoader)  # it says more precisely where an error is
        config = OmegaConf.create(text)
        return config, OmegaConf.to_container(config, resolve=False)
    except INVALID as error:
        raise ValueError(f"{path}: expected plain YAML, got {_problem(error, text)}") from error


def read_json(path: Path, limit: int = MAX_JSON) -> Any:
    """Read a JSON file.

    Args:
        path: path of the file.
        limit: maximum size of the file in bytes.

    Raises:
        FileNotFoundError: if there is no such file.
        ValueError: for a file that is too large, nested too deeply or not JSON.
    """
    return parsed_json(str(path), _text(path, limit))


def parsed_json(source: str, text: str | bytes) -> Any:
    """Parse a JSON text.

    Args:
        source: where the text came from, for the message.
        text: the JSON, as a string or as UTF-8 bytes.

    Raises:
        ValueError: for text that is nested too deeply, holds too many lists and objects, or is not JSON.
    """
    nests = text.count("[") + text.count("{") if isinstance(text, str) else text.count(b"[") + text.count(b"{")
    if nests > MAX_NESTS:
        raise ValueError(f"{source}: expected JSON with at most {MAX_NESTS:,} lists and objects, got {nests:,}")
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:  # invalid JSON or UTF-8, or numbers with thousands of digits
        raise ValueError(f"{source}: expected JSON, got {error}") from error


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write JSON atomically; numbers that JSON does not have, NaN and infinities, become null."""
    finite = json.loads(json.dumps(content), parse_constant=lambda _: None)
    text = json.dumps(finite, indent=2)
    with replacing(path) as stream:
        stream.write(f"{text}\n".encode())


def _text(path: Path, limit: int) -> str:
    if not path.is_file():
        raise FileNotFoundError(f"{path}: expected a file, found none")
    with path.open("rb") as stream:
        content = stream.read(min(limit, path.stat().st_size) + 1)
    if len(content) > limit:
        raise ValueError(f"{path}: expected at most {limit:,} bytes, got more")
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected UTF-8 text, got {error}") from error


def _check_events(text: str, loader: Any) -> None:
    """Refuse aliases, unusual tags and deep nesting in one pass over the parser's events, before objects are built."""
    depth = 0
    for event in yaml.parse(text, Loader=loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise ValueError(f"values nested more than {MAX_DEPTH} deep")
        if isinstance(event, yaml.AliasEvent):
            raise ValueError(f"the alias *{event.anchor}")
        tag = getattr(event, "tag", None)
        if tag is not None and tag not in PLAIN:
            raise ValueError(f"the tag {tag.replace(TAGS, '!!')} in line {event.start_mark.line + 1}")


def _problem(error: Exception, text: str) -> str:
    """Return in one line what is wrong with a YAML text; the parser's own message quotes the text in several."""
    if isinstance(error, yaml.reader.ReaderError):
        line, column = text.count("\n", 0, error.position) + 1, error.position - text.rfind("\n", 0, error.position)
        return f"an error in line {line}, column {column}: the character {chr(error.character)!r}"
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        line, column = error.problem_mark.line + 1, error.problem_mark.column + 1
        return f"an error in line {line}, column {column}: {error.problem}"
    return " ".join(str(error).split()) or type(error).__name__


def _texts(node: Any) -> Iterator[str]:
    """Yield every string among plain values, including keys."""
    if isinstance(node, str):
        yield node
    elif isinstance(node, dict | list):
        for each in [*node, *node.values()] if isinstance(node, dict) else node:
            yield from _texts(each)
