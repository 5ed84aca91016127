"""Checks of the words of a command line: that each is an override or an option of Hydra, whole and spelled as one."""

import re
import shlex
from collections.abc import Sequence

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from splatrl.configuration.scene_choice import SWEEP
from splatrl.configuration.search_path import composed, is_group, options

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


class UserError(ValueError):
    """A mistake on the command line."""


def check_brackets(arguments: Sequence[str]) -> None:
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


def check_spelled(name: str, arguments: Sequence[str]) -> None:
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
            if ":" in word and _is_ours(word.partition(":")[0], name):
                meant = word.replace(":", "=", 1)
            raise UserError(f"{word}: expected key=value; did you mean {meant}?")


def check_beside_run(folder: str, arguments: Sequence[str]) -> None:
    """Refuse overrides, in the words in which they were typed, of what a run's own settings decide."""
    typed = [word for word in arguments if "=" in word or word.startswith("~")]
    known = (*OF_A_RUN, "place")
    others = [word for word in typed if not word.startswith(("-", "hydra")) and word.partition("=")[0] not in known]
    if others:
        valid = f"{', '.join(OF_A_RUN)}, and a place such as scene=yard:1,"
        raise UserError(f"run={folder}: expected only {valid} with it, got {', '.join(others)}")


def _is_ours(key: str, name: str) -> bool:
    cfg = composed([], name)
    try:
        return is_group(key) or key in list(cfg) or OmegaConf.select(cfg, key, throw_on_missing=False) is not None
    except OmegaConfBaseException:  # a path such as ../
        return False
