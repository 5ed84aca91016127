"""The ``--help`` page of a command, taken from the comments beside the keys in the YAML config files."""

import shutil
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import yaml
from hydra.core.config_loader import ConfigLoader
from hydra.types import RunMode
from omegaconf import OmegaConf

from splatrl.configuration.search_path import composed, config_loader

WIDEST, NARROWEST, COLUMN = 100, 60, 36
"""Widest and narrowest line (the terminal decides between them), and the column where explanations begin."""
MOST_USED = {
    "train": (
        "scene",
        "task",
        "scene.path",
        "robot.height",
        "landmarks.goal",
        "collector.total_frames",
        "env.num_envs",
        "seed",
        "device",
        "resume",
        "demos",
        "task.max_steps",
        "logger.backend",
        "evaluation.starts",
    ),
    "record": ("by", "episodes", "out", "lerobot", "scene", "task", "scene.path", "robot.height", "landmarks.goal"),
}
"""Choices and keys to list first, per command; the other commands have few keys, already ordered in their YAML."""
HYDRAS = {
    "-m, --multirun": "run every combination of comma-separated values, as in seed=0,1,2",
    "--cfg job": "print the config and stop",
    "--hydra-help": "Hydra's own options",
}


@dataclass
class ConfigFile:
    """The comments of one YAML file.

    Attributes:
        header: the first comment.
        package: the package of its keys, from its ``# @package`` line; None if it has none and the group decides.
        groups: comments beside the entries of its defaults list, by group.
        keys: comments beside its keys, by the full dotted key within the file.
    """

    header: str = ""
    package: str | None = None
    groups: dict[str, str] = field(default_factory=dict)
    keys: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Choice:
    """A config group and the option chosen from it.

    Attributes:
        key: the name typed on the command line, such as ``task`` or ``motion@task.motion``.
        taken: the chosen option.
        options: one line about each option, by name.
        comment: what the group decides.
    """

    key: str
    taken: str
    options: dict[str, str]
    comment: str


@dataclass(frozen=True)
class KeyHelp:
    """The explanations for a composed config.

    Attributes:
        header: how the command is typed, and what it is for.
        choices: config groups, the most used first.
        values: the value of each key, formatted as in YAML; a subtree without explanations of its own is folded into
            its explained parent.
        comments: explanation of each key, including keys that contain others.
    """

    header: str
    choices: list[Choice]
    values: dict[str, str]
    comments: dict[str, str]

    @property
    def chosen(self) -> dict[str, Choice]:
        """Choices by the name typed on the command line."""
        return {choice.key: choice for choice in self.choices}


def help_page(name: str, overrides: Sequence[str] = ()) -> str:
    """Return the page that a command prints for ``--help``.

    Args:
        name: name of the root config.
        overrides: overrides in Hydra's grammar; the page describes the config with these applied.
    """
    found = key_help(name, overrides)
    usage, _, purpose = found.header.partition(": ")
    lines = [f"{usage} key=value ..." if "=" not in usage else usage, ""]
    lines += textwrap.wrap(purpose[:1].upper() + purpose[1:], _width())
    first = [key for key in MOST_USED.get(name, ()) if key in found.values or key in found.chosen]
    if first:
        lines += ["", "MOST USED", "", *(line for key in first for line in _of_key(key, found))]
    if found.choices:
        lines += ["", "CHOICES: name=option; * marks the selected option", ""]
    for choice in found.choices:
        lines += _entry(choice.key, choice.comment)
        for option, header in choice.options.items():
            lines += _entry(f"  {'*' if option == choice.taken else ' '} {option}", header)
    lines += ["", "ALL KEYS" if first else "KEYS", ""]
    alone = [key for key in found.values if "." not in key]
    for key in alone:
        lines += _of_key(key, found)
    for section in dict.fromkeys(key.partition(".")[0] for key in found.values if "." in key):
        lines.append("")
        keys = [key for key in found.values if key.startswith(f"{section}.")]
        for key in dict.fromkeys(part for whole in keys for part in _parts(whole)):
            if key in found.values or key in found.comments:
                lines += _of_key(key, found)
    lines += ["", "??? must be given; ${...} stands for the value of another key.", ""]
    return "\n".join([*lines, *(line for option, text in HYDRAS.items() for line in _entry(option, text))])


def _parts(key: str) -> Iterator[str]:
    """Yield the parents of a key and then the key itself: a, a.b, a.b.c."""
    words = key.split(".")
    return (".".join(words[: count + 1]) for count in range(len(words)))


def _of_key(key: str, found: KeyHelp) -> list[str]:
    """Return the lines of the page about a key or a choice."""
    if key in found.chosen and key not in found.values:
        return _entry(f"{key}={found.chosen[key].taken}", found.chosen[key].comment)
    shown = f"{key}={found.values[key]}" if key in found.values else key
    return _entry(shown, found.comments.get(key, ""))


def _width() -> int:
    return max(NARROWEST, min(WIDEST, shutil.get_terminal_size((WIDEST, 24)).columns))


def _entry(left: str, right: str) -> list[str]:
    """Return a term with its explanation beside it, or below it if the term is too long."""
    indent = " " * COLUMN
    lines = textwrap.wrap(right, _width(), initial_indent=indent, subsequent_indent=indent)
    if lines and len(left) < COLUMN - 1:
        return [left.ljust(COLUMN) + lines[0].lstrip(), *lines[1:]]
    return [*textwrap.wrap(left, _width(), subsequent_indent=" " * 8, break_on_hyphens=False), *lines]


def key_help(name: str, overrides: Sequence[str] = ()) -> KeyHelp:
    """Explain a composed config by the comments of the YAML files that it is composed of.

    A key without a comment in these files takes the comment from another option of the same group, so that keys that
    the options share need to be explained only once.

    Args:
        name: name of the root config.
        overrides: overrides in Hydra's grammar.
    """
    comments: dict[str, str] = {}
    of_others: dict[str, str] = {}
    groups: dict[str, str] = {}
    headers: dict[str, dict[str, str]] = {}
    with config_loader() as loader:
        header = _read(loader, name).header
        taking = loader.compute_defaults_list(name, list(overrides), RunMode.RUN)
        for default in taking.defaults:
            path, place = str(default.config_path), default.package or ""
            group, _, taken = path.rpartition("/")
            if path.startswith("hydra/"):
                continue
            options = [f"{group}/{option}" for option in loader.get_group_options(group)] if group else [path]
            files = {option.rpartition("/")[2]: _read(loader, option) for option in options}
            headers[group] = {option: file.header for option, file in files.items()}
            for option, file in files.items():
                groups = file.groups | groups
                usual = place if files[taken].package is None else group.replace("/", ".")
                start = place if option == taken else usual if file.package is None else file.package
                known = comments if option == taken else of_others
                for key, text in file.keys.items():
                    known.setdefault(f"{start}.{key}".strip("."), text)
    comments = of_others | comments
    choices = []
    for key, taken in taking.overrides.known_choices.items():  # from last to first
        group, _, place = str(key).partition("@")
        if group not in headers:
            continue
        if group in groups:
            choices.append(Choice(str(key), str(taken), headers[group], groups[group]))
        else:  # not a choice: a node that the header of its file explains as a whole
            comments = {own: text for own, text in comments.items() if not own.startswith(f"{place}.")}
            comments[place] = headers[group][str(taken)]
    told = {part for key in comments for part in _parts(key)}
    values = dict(_values(OmegaConf.to_container(composed(overrides, name)), "", comments, told))
    return KeyHelp(header, choices, values, comments)


def _values(node: Any, place: str, comments: dict[str, str], told: set[str]) -> Iterator[tuple[str, str]]:
    """Yield the keys to list and their values as text, leaving out ``_target_`` and ``_partial_``."""
    for key, value in node.items():
        where = f"{place}.{key}".lstrip(".")
        within = isinstance(value, dict) and any(f"{where}.{name}" in told for name in value)
        if str(key) in ("_target_", "_partial_"):
            continue
        if isinstance(value, dict) and value and (within or where not in comments):
            yield from _values(value, where, comments, told)
        else:
            yield where, _written(value)


def _written(value: object) -> str:
    """Write a value as it would be typed on the command line."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, dict):
        return "{...}" if value else "{}"
    return f"[{','.join(map(_written, value))}]" if isinstance(value, list) else str(value)


def _read(loader: ConfigLoader, path: str) -> ConfigFile:
    """Read the comments of a config on the search path; empty if the config is not a file."""
    for source in loader.get_sources():
        if source.is_config(path):
            if source.scheme() not in ("file", "pkg"):
                break
            folder = Path(source.path) if source.scheme() == "file" else resources.files(source.path.replace("/", "."))
            return comments_of((folder / f"{path}.yaml").read_text(encoding="utf-8"))
    return ConfigFile()


def comments_of(text: str) -> ConfigFile:
    """Extract the comments of a YAML file.

    Args:
        text: content of the file, whose root is a mapping.
    """
    result, lines = ConfigFile(), text.splitlines()
    for said in [line.partition("#")[2].strip() for line in lines]:
        if said.startswith("@package"):
            package = said.split()[1]
            result.package = "" if package == "_global_" else package
        elif not result.header:
            result.header = said
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    for key, value in root.value if isinstance(root, yaml.MappingNode) else []:
        if key.value != "defaults":
            result.keys.update(_beside(key, value, "", lines))
            continue
        entries = [entry for item in value.value if isinstance(item, yaml.MappingNode) for entry in item.value]
        for group, option in entries:
            said = _comment(option, lines)
            if said and not group.value.startswith("override "):  # beside an override it says why, not what
                result.groups[group.value.lstrip("/").partition("@")[0]] = said
    return result


def _beside(key: yaml.Node, value: yaml.Node, place: str, lines: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the comments beside a key and beside the keys that it contains."""
    where = f"{place}.{key.value}".lstrip(".")
    block = isinstance(value, yaml.CollectionNode) and not value.flow_style and len(value.value) > 0
    if said := _comment(key if block else value, lines):
        yield where, said
    for inner, its_value in value.value if isinstance(value, yaml.MappingNode) else []:
        yield from _beside(inner, its_value, where, lines)


def _comment(node: yaml.Node, lines: Sequence[str]) -> str:
    """Return the comment that follows a node on its last line."""
    line = lines[node.end_mark.line] if node.end_mark.line < len(lines) else ""
    return line[node.end_mark.column :].partition("#")[2].strip()
