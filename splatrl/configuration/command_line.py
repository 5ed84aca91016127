"""Command-line checks that run before Hydra: every mistake gives one line that says what to type instead."""

import difflib
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf

from splatrl.configuration.grammar import readable
from splatrl.configuration.key_help import help_page
from splatrl.configuration.kinds import check_kind, value_of
from splatrl.configuration.run_configs import RUN_CONFIG, run_config, typed_targets
from splatrl.configuration.scene_choice import SEEDED, SWEEP, load_config, with_scene_paths
from splatrl.configuration.search_path import choice_keys, composed, group_choices, is_group, options
from splatrl.configuration.spelling import SPELLED, viewed_run

OWN_CONFIG = ("--config-dir", "-cd", "--config-name", "-cn", "--config-path", "-cp")
"""Hydra options that select a config other than ours."""
WITH_VALUE = (*OWN_CONFIG, "--cfg", "-c", "--package", "-p", "--info", "-i", "--experimental-rerun")
"""Hydra options that take the next word as their value."""
HELP = ("-h", "--help")
MAIN_KEYS = {
    "train": "scene",
    "evaluate": "run",
    "clips": "run",
    "experiment": "name",
    "export": "run",
    "record": "scene",
    "replay": "demos",
    "view": "scene",
}
"""The key, per command, that a bare word without ``=`` was probably meant for."""
OF_A_RUN = ("run", "evaluation.checkpoint", "host", "port", "device", "allow_targets")
"""Of ``splatrl-view``, the only keys besides ``place`` that may stand beside ``run``: a run brings its settings."""
LAUNCHERS = {"ray": "hydra-ray-launcher", "submitit_slurm": "hydra-submitit-launcher"}
"""The packages with the launchers of our presets."""
INSTALL = "pip install 'splatrl[cluster]', and for Ray pip install --no-deps hydra-ray-launcher"
"""How to install them."""
MOST_NEAR = 3  # similar keys to suggest, at most


class UserError(ValueError):
    """A mistake on the command line."""


def command_line(name: str, arguments: Sequence[str]) -> list[str]:
    """Check a command's arguments and return them for Hydra, with a path after ``scene=`` rewritten.

    Args:
        name: name of the root config.
        arguments: the command-line arguments.

    Raises:
        SystemExit: with one line that names the argument, what was expected and what was given; or after printing the
            page for ``--help``.
    """
    arguments = SPELLED.get(name, list)([readable(word) for word in arguments])
    try:
        _check_words(name, arguments)
        if name == "view" and (folder := viewed_run(arguments)):
            _check_beside_run(folder, arguments)
        result = _options_first(with_scene_paths(arguments, name))
        if any(argument.partition("=")[0] in OWN_CONFIG for argument in arguments):
            return result  # the user's own config: Hydra reports unknown keys
        sweeps = any(argument in SWEEP for argument in arguments)
        overrides = [_parsed(word, sweeps) for word in result if _is_plain(word)]
        for word in result:
            if "=" in word and word.startswith(("+", "~", "hydra")):
                _check_launcher(_parsed(word, sweeps=True))
        _check_overrides(name, overrides)
        passed = _forced if _resumed(overrides) else str
        if any(argument in HELP for argument in arguments):
            single = [passed(str(override.input_line)) for override in overrides if not override.is_sweep_override()]
            _print_page(help_page(name, single))
            sys.exit()
    except ValueError as error:
        sys.exit(f"splatrl-{name}: {error}")
    return list(map(passed, result))


def _options_first(words: Sequence[str]) -> list[str]:
    """Move Hydra's options in front of the overrides: its parser rejects overrides on both sides of an option."""
    pairs = list(zip(["", *words], words, strict=False))
    options = [word for before, word in pairs if word.startswith("-") or before in WITH_VALUE]
    return [*options, *(word for before, word in pairs if not (word.startswith("-") or before in WITH_VALUE))]


def _print_page(page: str) -> None:
    """Print a page, tolerating a reader such as ``head`` that closes the pipe early."""
    try:
        print(page, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python complains at exit


def _is_plain(word: str) -> bool:
    """Whether a word overrides one of our keys or groups."""
    return "=" in word and not word.startswith(("-", "+", "~", "hydra"))


def _check_words(name: str, arguments: Sequence[str]) -> None:
    """Refuse words that are neither overrides nor Hydra options."""
    for before, word in zip(["", *arguments], arguments, strict=False):
        key, _, value = word.lstrip("-").partition("=")
        if word.startswith("--") and _is_ours(key, name):
            raise UserError(f"{word}: expected {key}={value or '...'}, without --")
        if "=" not in word and not word.startswith(("-", "~", "+")) and before not in WITH_VALUE:
            groups = [group for group in ("task", "scene") if name == "train" and word in options(group)]
            meant = f"{word}=..." if _is_ours(word, name) else f"{(*groups, MAIN_KEYS[name])[0]}={word}"
            raise UserError(f"{word}: expected key=value; did you mean {meant}?")


def _check_beside_run(folder: str, arguments: Sequence[str]) -> None:
    """Refuse overrides, in the words in which they were typed, of what a run's own settings decide."""
    typed = [word for word in arguments if "=" in word or word.startswith("~")]
    known = (*OF_A_RUN, "place")
    others = [word for word in typed if not word.startswith(("-", "hydra")) and word.partition("=")[0] not in known]
    if others:
        valid = f"{', '.join(OF_A_RUN)}, and a place such as scene=yard:1,"
        raise UserError(f"run={folder}: expected only {valid} with it, got {', '.join(others)}")


def _is_ours(key: str, name: str) -> bool:
    cfg = load_config(name=name)
    return is_group(key) or key in list(cfg) or OmegaConf.select(cfg, key, throw_on_missing=False) is not None


def _parsed(word: str, sweeps: bool) -> Override:
    key = word.partition("=")[0]
    try:
        override: Override = OverridesParser.create().parse_override(word)
    except HydraException as error:
        raise UserError(f"{word}: expected {key}=value with balanced brackets and special characters quoted") from error
    if override.is_sweep_override() and not sweeps:
        text = word.partition("=")[2]
        several = f"scene=many 'scene.paths=[{text}]' for several" if key == "scene" else f"{key}=[{text}] for a list"
        raise UserError(f"{key}: expected one value, got {text}; type {several}, or -m for a sweep")
    return override


def _check_overrides(name: str, overrides: Sequence[Override]) -> None:
    """Refuse options that a group lacks, unknown keys, and values of a different kind from the default."""
    groups = [override for override in overrides if is_group(override.key_or_group)]
    for override in groups:
        for choice in _choices(override):
            for one in choice.strip("[]").split(","):  # sensors takes a list
                _check_choice(override.key_or_group, one.strip())
    for override in overrides:
        if override.key_or_group == "resume":  # its config says which keys there are
            _check_run(override)
    chosen = [f"{str(override.input_line).partition('=')[0]}={_choices(override)[0]}" for override in groups]
    folder = _resumed(overrides)
    try:
        known = run_config(folder, typed_targets(overrides)) if folder else composed(chosen, name)
    except HydraException:
        _check_places(name, chosen)
        return  # Hydra will report what is wrong
    for override in overrides:
        if override not in groups:
            _check_key(override.key_or_group, known)
            for value in _values(override):
                check_kind(override.key_or_group, value_of(known, override.key_or_group), value)
    for override in overrides:
        if override.key_or_group == "run":
            _check_run(override)


def _resumed(overrides: Sequence[Override]) -> Path | None:
    """Return the folder of the run to resume, in a sweep the first; None for a new run."""
    typed = [value for override in overrides if override.key_or_group == "resume" for value in _values(override)]
    return Path(typed[0]) if typed and isinstance(typed[0], str) else None


def _forced(word: str) -> str:
    """Let Hydra take a key that only a run has: it composes the usual config, which the run's then replaces."""
    key, equals, _ = word.lstrip("+").partition("=")
    plain = equals and not word.startswith(("-", "~", "hydra", "resume=")) and not is_group(key)
    return f"++{word.lstrip('+')}" if plain else word


def _check_launcher(override: Override) -> None:
    """Refuse a launcher whose plugin for Hydra is not installed."""
    for choice in _choices(override) if override.key_or_group == "launcher" else ():
        _check_choice("launcher", choice)
        for group, option in group_choices("launcher", choice).items():
            if option not in options(group):
                raise UserError(f"+launcher={choice}: {LAUNCHERS.get(choice, 'its plugin')} is missing; {INSTALL}")


def _check_places(name: str, chosen: Sequence[str]) -> None:
    """Refuse a choice for a place that no config has, such as ``motion@task.motin``."""
    keys = [word.partition("=")[0] for word in chosen]
    with suppress(HydraException):
        known = choice_keys(name, [word for word, key in zip(chosen, keys, strict=True) if "@" not in key])
        for key in (key for key in keys if "@" in key and key not in known):
            if valid := [one for one in known if one.startswith(f"{key.partition('@')[0]}@")]:
                raise UserError(f"{key}: expected {' or '.join(valid)} as the key, got {key}")


def _check_run(override: Override) -> None:
    """Refuse a path that is not a run folder, because Hydra would create a folder of that name."""
    for folder in _values(override):
        if isinstance(folder, str) and not (Path(folder) / RUN_CONFIG).is_file():
            raise UserError(f"{override.key_or_group}: expected a run folder with {RUN_CONFIG}, got {folder}")


def _values(override: Override) -> list[object]:
    if override.is_sweep_override():
        return list(override.sweep_iterator()) if override.is_choice_sweep() else []
    return [override.value()]


def _choices(override: Override) -> list[str]:
    swept = override.is_sweep_override()
    return list(override.sweep_string_iterator()) if swept else [override.get_value_element_as_str()]


def _check_choice(key: str, choice: str) -> None:
    group, choice = key.partition("@")[0], choice.replace("\\:", ":")  # undo the escaping
    valid = options(group)
    if choice in valid or choice in ("null", ""):
        return
    near = difflib.get_close_matches(choice.lower(), valid, 1)
    hint = f"; did you mean {key}={near[0]}?" if near else ""
    if group == "scene" and (SEEDED.fullmatch(choice) or Path(choice).exists()):
        kinds = "only names of configs, only existing paths, or only seeds such as yard:1,yard:2"
        raise UserError(f"{key}: expected {kinds}, got {choice} among others")
    paths = ", or an existing path" if group == "scene" else ""
    raise UserError(f"{key}: expected one of {', '.join(valid)}{paths}, got {choice}{hint}")


def _check_key(key: str, known: DictConfig) -> None:
    *parents, leaf = key.split(".")
    node = value_of(known, ".".join(parents)) if parents else known
    keys = list(node) if isinstance(node, DictConfig) else []
    if leaf in keys:
        return
    valid = [str(one) for one in keys if not str(one).startswith("_")]
    near = [".".join([*parents, match]) for match in difflib.get_close_matches(leaf, valid, 1)]
    near = near or _near_keys(leaf, known)
    near = ["scene=<the path>"] if key == "scene.path" else near
    hint = f", did you mean {' or '.join(near)}?" if near else "."
    place = ".".join(parents)
    if valid:
        known_keys = f"Valid keys {f'of {place}' if parents else 'at the top level'}: {', '.join(valid)}"
    elif options(place):
        known_keys = f"{place} is a config group with the options {', '.join(options(place))}"
    else:
        known_keys = f"{place} has no keys"
    raise UserError(f"{key}: no such key{hint} {known_keys}")


def _near_keys(word: str, known: DictConfig) -> list[str]:
    """Return full keys whose last part resembles a word or contains it between underscores."""
    leaves = list(_leaves(OmegaConf.to_container(known, resolve=False), ""))
    names = {key.rpartition(".")[2] for key in leaves}
    near = {*difflib.get_close_matches(word, names), *(name for name in names if word in name.split("_"))}
    return sorted(key for key in leaves if key.rpartition(".")[2] in near)[:MOST_NEAR]


def _leaves(node: object, place: str) -> Iterator[str]:
    """Yield the dotted keys of all leaf values, except those such as ``_target_`` that say what to build."""
    if not isinstance(node, dict):
        yield place
        return
    for key, value in node.items():
        if not str(key).startswith("_"):
            yield from _leaves(value, f"{place}.{key}" if place else str(key))
