"""Command-line checks that run before Hydra: every mistake gives one line that says what to type instead."""

import difflib
import itertools
import re
import shlex
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from splatrl.configuration.grammar import bare, overrides_parser, quoted, readable
from splatrl.configuration.key_help import help_page, key_help
from splatrl.configuration.kinds import check_kind, value_of
from splatrl.configuration.known_keys import check_key
from splatrl.configuration.run_configs import RUN_CONFIG, run_config, typed_targets
from splatrl.configuration.scene_choice import SEEDED, SWEEP, load_config, with_proposals, with_scene_chosen
from splatrl.configuration.search_path import choice_keys, group_choices, is_group, options
from splatrl.configuration.spelling import SPELLED, viewed_run
from splatrl.configuration.sweeps import check_sweeps, choices, compositions, directed, values
from splatrl.files import expanded

OWN_CONFIG = ("--config-dir", "-cd", "--config-name", "-cn", "--config-path", "-cp")
"""Hydra options that select a config other than ours."""
WITH_VALUE = (*OWN_CONFIG, "--cfg", "-c", "--package", "-p", "--info", "-i", "--experimental-rerun")
"""Hydra options that take the next word as their value."""
HELP = ("-h", "--help")
OPTIONS = (*WITH_VALUE, *HELP, *sorted(SWEEP), "--run", "-r", "--resolve", "--hydra-help", "--shell-completion", "-sc")
"""All options of Hydra that we let it take."""
SHOWING = ("--cfg", "-c", "--info", "-i")
"""Hydra options that show something instead of running."""
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
PLUGINS = {"ray": "hydra-ray-launcher", "submitit_slurm": "hydra-submitit-launcher", "optuna": "hydra-optuna-sweeper"}
"""The packages with launchers and sweepers of Hydra."""
INSTALL = {
    "hydra/launcher": "pip install 'splatrl[cluster]', and for Ray pip install --no-deps hydra-ray-launcher",
    "hydra/sweeper": "pip install hydra-optuna-sweeper",
}
"""How to install them."""


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
    arguments = [readable(word) for word in arguments]
    try:
        _check_brackets(arguments)
        arguments = SPELLED.get(name, list)(arguments)
        _check_words(name, arguments)
        if name == "view" and (folder := viewed_run(arguments)):
            _check_beside_run(folder, arguments)
        words = with_scene_chosen(arguments, name)
        own = any(argument.partition("=")[0] in OWN_CONFIG for argument in arguments)
        if not own:
            _check_chosen(name, words)  # before with_proposals, which may generate yards
        words = with_proposals(words, name)
        result = _options_first(directed(words) if name == "train" else words)
        if own:
            return result  # the user's own config: Hydra reports unknown keys
        overrides = _plain(result)
        passed = _forced if _resumed(overrides) else str
        if any(argument in HELP for argument in arguments):
            single = [passed(str(override.input_line)) for override in overrides if not override.is_sweep_override()]
            print(help_page(name, single))
            sys.exit()
    except ValueError as error:
        sys.exit(f"splatrl-{name}: {error}")
    return list(map(passed, result))


def check_words(name: str, words: Sequence[str]) -> None:
    """Refuse overrides that do not fit the configs, as the command line does, with a ``UserError``.

    Args:
        name: name of the root config.
        words: overrides in Hydra's grammar.
    """
    _check_words(name, words)
    _check_chosen(name, with_scene_chosen(words, name))


def _check_chosen(name: str, words: Sequence[str]) -> None:
    """Refuse overrides that do not fit the configs, in words in which the scene is chosen."""
    overrides = _plain(words)
    for word in words:
        if "=" in word and word.startswith(("+", "~", "hydra")):
            _check_plugin(_parsed(word, sweeps=True))
    if not any(word.startswith("hydra/sweeper=") for word in words):
        check_sweeps(overrides)
    _check_overrides(name, overrides)
    _check_deletions(name, words, overrides)


def _plain(words: Sequence[str]) -> list[Override]:
    """Return the overrides of our keys and groups among words, parsed."""
    sweeps = any(word in SWEEP for word in words)
    return [_parsed(word, sweeps) for word in words if _is_plain(word)]


def _options_first(words: Sequence[str]) -> list[str]:
    """Move Hydra's options in front of the overrides: its parser rejects overrides on both sides of an option."""
    pairs = list(zip(["", *words], words, strict=False))
    options = [word for before, word in pairs if word.startswith("-") or before in WITH_VALUE]
    return [*options, *(word for before, word in pairs if not (word.startswith("-") or before in WITH_VALUE))]


def _is_plain(word: str) -> bool:
    """Whether a word overrides one of our keys or groups."""
    return "=" in word and not word.startswith(("-", "+", "~", "hydra"))


def _check_brackets(arguments: Sequence[str]) -> None:
    """Refuse a list or dictionary with blanks that was not quoted, which the shell has split into several words."""
    for place, word in enumerate(arguments):
        if "=" in word and not word.startswith("-") and _open(word) > 0:
            ends = (end for end in range(place + 2, len(arguments) + 1) if _open(" ".join(arguments[place:end])) == 0)
            if end := next(ends, None):
                raise UserError(f"{word}: expected one word; quote it: {shlex.quote(' '.join(arguments[place:end]))}")


def _open(text: str) -> int:
    """Return how many more brackets a text opens than it closes, outside quotes."""
    text = re.sub(r"'[^']*'|\"[^\"]*\"", "", text)
    return sum(text.count(bracket) for bracket in "[{") - sum(text.count(bracket) for bracket in "]}")


def _check_words(name: str, arguments: Sequence[str]) -> None:
    """Refuse words that are neither overrides nor Hydra options, and options that Hydra cannot combine."""
    shown = [word for word in arguments if word.partition("=")[0] in SHOWING]
    if shown and SWEEP.intersection(arguments):
        raise UserError(
            f"{shown[0]}: expected no -m beside it, since it shows a single run; leave out -m and all sweeps"
        )
    for before, word in zip(["", *arguments], arguments, strict=False):
        key, _, value = word.lstrip("-").partition("=")
        if word.startswith("-") and _is_ours(key, name):
            dashes = word[: len(word) - len(word.lstrip("-"))]
            raise UserError(f"{word}: expected {key}={value or '...'}, without {dashes}")
        if word.startswith("-") and word.partition("=")[0] not in OPTIONS and before not in WITH_VALUE:
            raise UserError(f"{word}: expected key=value, or an option that --hydra-help lists")
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
    try:
        return is_group(key) or key in list(cfg) or OmegaConf.select(cfg, key, throw_on_missing=False) is not None
    except OmegaConfBaseException:  # a path such as ../
        return False


def _parsed(word: str, sweeps: bool) -> Override:
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
        several = f"scene=many 'scene.paths=[{text}]' for several" if key == "scene" else f"{key}=[{text}] for a list"
        raise UserError(f"{key}: expected one value, got {text}; type {several}, or -m for a sweep")
    return override


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
    folder, first = _resumed(overrides), [several[0] for several in chosen]
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
    if folder := _resumed(overrides):
        raise UserError(f"resume={folder}: expected values for keys of the run, got {', '.join(deleted)}")
    typed = [word.lstrip("+").partition("=")[0] for word in words if not word.startswith("~")]
    added = [_parsed(word, sweeps=True) for word in words if word.startswith("+") and "=" in word]
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


def _resumed(overrides: Sequence[Override]) -> Path | None:
    """Return the folder of the run to resume, in a sweep the first; None for a new run."""
    typed = [value for override in overrides if override.key_or_group == "resume" for value in values(override)]
    return Path(typed[0]) if typed and isinstance(typed[0], str) else None


def _forced(word: str) -> str:
    """Let Hydra take a key that only a run has: it composes the usual config, which the run's then replaces."""
    key, equals, _ = word.lstrip("+").partition("=")
    plain = equals and not word.startswith(("-", "~", "hydra", "resume=")) and not is_group(key)
    return f"++{word.lstrip('+')}" if plain else word


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
            check_key(key, [{"": load_config(name=name)}])


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
    paths = ", or an existing path" if group == "scene" else ""
    raise UserError(f"{key}: expected one of {', '.join(valid)}{paths}, got {choice}{hint}")
