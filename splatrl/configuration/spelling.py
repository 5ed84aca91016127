"""Other spellings of arguments that some commands accept."""

from collections.abc import Callable, Sequence
from pathlib import Path

from splatrl.configuration.elsewhere import words_of_place
from splatrl.configuration.grammar import bare, quoted
from splatrl.configuration.run_configs import RUN_CONFIG
from splatrl.configuration.search_path import choice_keys


def with_key(arguments: Sequence[str]) -> list[str]:
    """Prefix the first bare word with a key: ``run=`` if it is a run folder, and ``scene=`` otherwise."""
    result = list(arguments)
    for place, word in enumerate(result):
        if "=" not in word and not word.startswith(("-", "+", "~")):
            is_run = (Path(word) / RUN_CONFIG).is_file()
            plain = word.replace("_", "").isalnum()
            result[place] = f"{'run' if is_run else 'scene'}={word if plain else quoted(word)}"
            break
    return result


def viewed_run(arguments: Sequence[str]) -> str | None:
    """Return the run folder that was typed for ``splatrl-view``; None without one."""
    runs = [bare(word.partition("=")[2]) for word in arguments if word.startswith("run=")]
    return runs[-1] if runs and runs[-1] != "null" else None


def _of_evaluation(arguments: Sequence[str]) -> list[str]:
    """Translate the keys of a training into those of ``splatrl-evaluate``: ``evaluation.starts=64`` to ``starts=64``.

    Overrides that describe the place are collected.
    """
    return [word.removeprefix("evaluation.") for word in _with_place(arguments)]


def _of_view(arguments: Sequence[str]) -> list[str]:
    """Prefix a bare word with its key and, beside a run, collect overrides that describe the place, except its task."""
    words = with_key(arguments)
    if viewed_run(words) is None:
        return words
    tasks = [word for word in words if word.startswith("task=")]
    return [*tasks, *_with_place([word for word in words if word not in tasks])]


def _with_place(arguments: Sequence[str]) -> list[str]:
    """Collect overrides that describe the place of a run, such as ``scene=kitchen``, in one list, ``place``."""
    place, words = words_of_place([_without_plus_of_choice(word) for word in arguments])
    words = _without_plus(words)
    return [*words, f"place=[{','.join(map(quoted, place))}]"] if place else words


def _without_plus_of_choice(word: str) -> str:
    """Drop the ``+`` that Hydra advises for a choice of a transform that every run has made already."""
    key = word.lstrip("+").partition("=")[0]
    return word.lstrip("+") if key.startswith("transforms/") and key in choice_keys("train", []) else word


def _without_plus(arguments: Sequence[str]) -> list[str]:
    """Drop the ``+`` of words that would add a key, which the command would not read; unknown keys are then refused.

    Choices for a place that they name (``+experiment@experiments.mine=mine``), arms and scenes of experiments, and
    words about Hydra itself stay.
    """
    plain = [word.lstrip("+") for word in arguments]
    own = ("hydra", "experiments.", "scene_overrides.")
    stay = [word.startswith(own) or "@" in word.partition("=")[0] for word in plain]
    return [old if stays else new for old, new, stays in zip(arguments, plain, stay, strict=True)]


SPELLED: dict[str, Callable[[Sequence[str]], list[str]]] = {
    "evaluate": _of_evaluation,
    "experiment": _without_plus,
    "view": _of_view,
    "export": _with_place,
    "clips": _with_place,
    "replay": _with_place,
}
"""Commands that accept other spellings of some arguments, with the function that translates them."""
