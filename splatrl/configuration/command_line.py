"""Command-line checks that run before Hydra: every mistake gives one line that says what to type instead."""

import sys
from collections.abc import Sequence

from splatrl.configuration.grammar import readable
from splatrl.configuration.key_help import help_page
from splatrl.configuration.scene_choice import with_scene_chosen
from splatrl.configuration.scene_proposals import with_proposals
from splatrl.configuration.search_path import is_group
from splatrl.configuration.spelling import SPELLED, viewed_run
from splatrl.configuration.sweeps import directed
from splatrl.configuration.typed_overrides import check_chosen, plain_overrides, resumed
from splatrl.configuration.typed_words import (
    HELP,
    OWN_CONFIG,
    WITH_VALUE,
    check_beside_run,
    check_brackets,
    check_spelled,
)


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
        check_brackets(arguments)
        arguments = SPELLED.get(name, list)(arguments)
        check_spelled(name, arguments)
        if name == "view" and (folder := viewed_run(arguments)):
            check_beside_run(folder, arguments)
        words = with_scene_chosen(arguments, name)
        own = any(argument.partition("=")[0] in OWN_CONFIG for argument in arguments)
        if not own:
            check_chosen(name, words)  # before with_proposals, which may generate yards
        words = with_proposals(words, name)
        result = _options_first(directed(words) if name == "train" else words)
        if own:
            return result  # the user's own config: Hydra reports unknown keys
        overrides = plain_overrides(result)
        passed = _forced if resumed(overrides) else str
        if any(argument in HELP for argument in arguments):
            single = [passed(str(override.input_line)) for override in overrides if not override.is_sweep_override()]
            print(help_page(name, single))
            sys.exit()
    except ValueError as error:
        sys.exit(f"splatrl-{name}: {error}")
    return list(map(passed, result))


def _options_first(words: Sequence[str]) -> list[str]:
    """Move Hydra's options in front of the overrides: its parser rejects overrides on both sides of an option."""
    pairs = list(zip(["", *words], words, strict=False))
    options = [word for before, word in pairs if word.startswith("-") or before in WITH_VALUE]
    return [*options, *(word for before, word in pairs if not (word.startswith("-") or before in WITH_VALUE))]


def _forced(word: str) -> str:
    """Let Hydra take a key that only a run has: it composes the usual config, which the run's then replaces."""
    key, equals, _ = word.lstrip("+").partition("=")
    plain = equals and not word.startswith(("-", "~", "hydra", "resume=")) and not is_group(key)
    return f"++{word.lstrip('+')}" if plain else word
