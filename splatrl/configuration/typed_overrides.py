"""Checks of typed overrides against the configs: that their keys, choices and values exist and fit."""

import difflib
import itertools
import shlex
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf

from splatrl.configuration.grammar import bare, overrides_parser, quoted
from splatrl.configuration.key_help import key_help
from splatrl.configuration.kinds import check_kind, value_of
from splatrl.configuration.known_keys import check_key
from splatrl.configuration.run_configs import RUN_CONFIG, run_config, typed_targets
from splatrl.configuration.scene_choice import SEEDED, SWEEP
from splatrl.configuration.search_path import choice_keys, composed, group_choices, is_group, options
from splatrl.configuration.sweeps import check_sweeps, choices, compositions, values
from splatrl.configuration.typed_words import UserError
from splatrl.files import expanded

PLUGINS = {"ray": "hydra-ray-launcher", "submitit_slurm": "hydra-submitit-launcher", "optuna": "hydra-optuna-sweeper"}
"""The packages with launchers and sweepers of Hydra."""
INSTALL = {
    "hydra/launcher": "pip install 'splatrl[cluster]', and for Ray pip install --no-deps hydra-ray-launcher",
    "hydra/sweeper": "pip install hydra-optuna-sweeper",
}
"""How to install them."""


def check_chosen(name: str, words: Sequence[str]) -> None:
    """Refuse overrides that do not fit the configs, in words in which the scene is chosen."""
    overrides = plain_overrides(words)
    for word in words:
        if "=" in word and word.startswith(("+", "~", "hydra")):
            _check_plugin(parsed(word, sweeps=True))
    if not any(word.startswith("hydra/sweeper=") for word in words):
        check_sweeps(overrides)
    _check_overrides(name, overrides)
    _check_deletions(name, words, overrides)


def _check_overrides(name: str, overrides: Sequence[Override]) -> None:
    """Refuse options that a group lacks, unknown keys, and values of a different kind from the default."""
    groups = [override for override in overrides if is_group(override.key_or_group)]
    for override in groups:
        for choice in choices(override):
            for one in choice.strip("[]").split(","):  # sensors takes a list
                _check_choice(override.key_or_group, one.strip())
    for override in overrides:
        if override.key_or_group == "resume":  # its config says which keys there are
            _check_run(override)
    chosen = [[f"{str(one.input_line).partition('=')[0]}={choice}" for choice in choices(one)] for one in groups]
    folder, first = resumed(overrides), [several[0] for several in chosen]
    try:
        known = [{"": run_config(folder, typed_targets(overrides))}] if folder else compositions(chosen, name)
    except HydraException:
        _check_places(name, first)
        return  # Hydra will report what is wrong

    def may_be_null(key: str) -> bool:
        return "null" in key_help(name, [] if folder else first).comments.get(key, "")

    for override in (one for one in overrides if one not in groups):
        key = override.key_or_group
        check_key(key, known)
        for value, configs in itertools.product(values(override), known):
            for cfg in configs.values():
                check_kind(key, value_of(cfg, key), value, may_be_null)
    for override in overrides:
        if override.key_or_group == "run":
            _check_run(override)


def _check_deletions(name: str, words: Sequence[str], overrides: Sequence[Override]) -> None:
    """Refuse to delete keys that do not exist, that Hydra cannot delete, that every command reads, or of a run."""
    deleted = [word for word in words if word.startswith("~") and not word.startswith("~hydra")]
    if not deleted:
        return
    if folder := resumed(overrides):
        raise UserError(f"resume={folder}: expected values for keys of the run, got {', '.join(deleted)}")
    typed = [word.lstrip("+").partition("=")[0] for word in words if not word.startswith("~")]
    added = [parsed(word, sweeps=True) for word in words if word.startswith("+") and "=" in word]
    chosen = [
        f"{str(one.input_line).partition('=')[0]}={choices(one)[0]}"
        for one in (*overrides, *added)
        if is_group(one.key_or_group)
    ]
    with suppress(HydraException):  # Hydra will report what is wrong
        cfg, groups = compositions([[word] for word in chosen], name)[0][""], choice_keys(name, chosen)
        for word in deleted:
            key = word[1:].partition("=")[0]
            if key in groups and "." not in key:
                choice = "none" if "none" in options(key.split("@")[0]) else "..."
                raise UserError(f"{word}: expected another choice from this group; type {key}={choice} instead")
            if key not in (*groups, *typed):
                check_key(key, [{"": cfg}])
            above, _, leaf = key.rpartition(".")
            if not above:
                raise UserError(f"{word}: expected a key within a node, such as ~task.goal; all others are needed")
            if key not in (*groups, *typed) and _is_null(value_of(cfg, above), leaf):
                raise UserError(f"{word}: expected a key with a value, which null is not; type {key}=... instead")


def _is_null(node: object, key: str) -> bool:
    """Return whether a key of a node is null itself, and does not refer to another key, which may get a value."""
    assert isinstance(node, DictConfig), type(node)
    return not OmegaConf.is_interpolation(node, key) and value_of(node, key) is None


def _check_plugin(override: Override) -> None:
    """Refuse a launcher or a sweeper whose plugin for Hydra is not installed, and unknown options of Hydra's groups."""
    key = override.key_or_group
    for choice in choices(override) if key == "launcher" or key.startswith("hydra/") else ():
        if key == "launcher" or choice not in PLUGINS:
            _check_choice(key, choice)
        for group, option in (group_choices(key, choice) if key == "launcher" else {key: choice}).items():
            if option not in options(group):
                typed, install = str(override.input_line).partition("=")[0], INSTALL.get(group, "install it")
                raise UserError(f"{typed}={choice}: {PLUGINS.get(choice, 'its plugin')} is missing; {install}")


def _check_places(name: str, chosen: Sequence[str]) -> None:
    """Refuse a choice for a place that no config has, such as ``motion@task.motin``, or of a group that is not used."""
    keys, known = [word.partition("=")[0] for word in chosen], choice_keys(name, [])
    with suppress(HydraException):
        known = choice_keys(name, [word for word, key in zip(chosen, keys, strict=True) if "@" not in key])
    for key in (key for key in keys if key not in known):
        if valid := [one for one in known if one.startswith(f"{key.partition('@')[0]}@")]:
            raise UserError(f"{key}: expected {' or '.join(valid)} as the key, got {key}")
        if "@" not in key:
            check_key(key, [{"": composed([], name)}])


def _check_run(override: Override) -> None:
    """Refuse a path that is not a run folder, because Hydra would create a folder of that name."""
    for folder in values(override):
        if isinstance(folder, str) and not (Path(folder) / RUN_CONFIG).is_file():
            raise UserError(f"{override.key_or_group}: expected a run folder with {RUN_CONFIG}, got {folder}")


def _check_choice(key: str, choice: str) -> None:
    group, choice = key.partition("@")[0], bare(choice).replace("\\:", ":")  # undo quoting and escaping
    valid = options(group)
    if choice in valid or choice in ("null", ""):
        return
    near = difflib.get_close_matches(choice.lower(), valid, 1)
    hint = f"; did you mean {key}={near[0]}?" if near else ""
    if group == "scene" and (SEEDED.fullmatch(choice) or Path(choice).exists()):
        kinds = "only names of configs, only existing paths, or only seeds such as yard:1,yard:2"
        raise UserError(f"{key}: expected {kinds}, got {choice} among others")
    paths = ", one with a seed such as yard:3, or an existing path" if group == "scene" else ""
    raise UserError(f"{key}: expected one of {', '.join(valid)}{paths}, got {choice}{hint}")


def plain_overrides(words: Sequence[str]) -> list[Override]:
    """Return the overrides of our keys and groups among words, parsed."""
    sweeps = any(word in SWEEP for word in words)
    return [parsed(word, sweeps) for word in words if _is_plain(word)]


def _is_plain(word: str) -> bool:
    """Whether a word overrides one of our keys or groups."""
    return "=" in word and not word.startswith(("-", "+", "~", "hydra"))


def parsed(word: str, sweeps: bool) -> Override:
    """Parse an override; refuse one that cannot be parsed, and a sweep where there is none.

    Args:
        word: the override.
        sweeps: whether the command line asks for a sweep.
    """
    key = word.partition("=")[0]
    try:
        override: Override = overrides_parser().parse_override(word)
    except HydraException as error:
        if (parts := word.partition("=")[2]).startswith("[") and "=" in parts:
            elements = ",".join(quoted(bare(one.strip())) for one in parts.strip("[]").split(","))
            raise UserError(f'{key}: expected each element in quotes: "{key}=[{elements}]"') from error
        raise UserError(f"{word}: expected {key}=value with balanced brackets and special characters quoted") from error
    if override.is_sweep_override() and not sweeps:
        text = word.partition("=")[2]
        if expanded(text).exists():
            one = f"{key}={quoted(text)}"
            typed = shlex.quote(one) if set('"$`\\!').intersection(one) else f'"{one}"'
            raise UserError(f"{key}: expected quotes around a path with a comma; type {typed}")
        several = shlex.quote(f"scene.paths=[{text}]" if key == "scene" else f"{key}=[{text}]")
        typed = f"scene=many {several} for several" if key == "scene" else f"{several} for a list"
        raise UserError(f"{key}: expected one value, got {text}; type {typed}, or -m for a sweep")
    return override


def resumed(overrides: Sequence[Override]) -> Path | None:
    """Return the folder of the run to resume, in a sweep the first; None for a new run."""
    typed = [value for override in overrides if override.key_or_group == "resume" for value in values(override)]
    return Path(typed[0]) if typed and isinstance(typed[0], str) else None
