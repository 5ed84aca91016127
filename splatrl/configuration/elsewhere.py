"""The config of a run, moved to a place other than the one where its policy learned."""

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig

from splatrl.configuration.checking import check_constructors
from splatrl.configuration.run_configs import run_config
from splatrl.configuration.scene_choice import load_config
from splatrl.documents import read_yaml

PLACE = ("scene", "robot", "landmarks", "task", "collision", "renderer")
"""What of a run's config belongs to the place in which it was trained."""
OF_A_SCENE = ("scene", "landmarks", "task.motion.lower", "task.motion.upper")
"""What was typed about one scene and says nothing about another."""
OF_A_RUN = ("hydra", "resume", "resume_changed", "allow_targets", "view")
"""What was typed about one run."""
TYPED = Path(".hydra", "overrides.yaml")
"""What was typed for a run, as Hydra keeps it in the run folder."""


def placed(cfg: DictConfig, place: DictConfig) -> DictConfig:
    """The config of a run, moved to another's place, with a steady camera."""
    cfg = cfg.copy()
    for key in PLACE:
        cfg[key] = place[key]
    cfg.transforms.pose_noise = {}
    return cfg


def config_elsewhere(folder: Path, words: Sequence[str], allow_targets: Sequence[str] = ()) -> DictConfig:
    """The config of a run folder as it would be if something else had been typed for its place.

    Args:
        folder: the run folder, which may come from a stranger.
        words: overrides of the place, such as ``scene=kitchen``; another scene also replaces what was
            typed of the first one's goals and bounds.
        allow_targets: see ``run_config``.

    Raises:
        FileNotFoundError: where it is not known what was typed.
        ValueError: for words that no command line takes, or that would build what is not allowed.
    """
    own, path = run_config(folder, allow_targets), folder / TYPED
    if not path.is_file():
        raise FileNotFoundError(f"{path}: expected what was typed for the training, found no such file")
    typed = read_yaml(path)
    if not isinstance(typed, list) or not all(isinstance(word, str) and "${" not in word for word in typed):
        raise ValueError(f"{path}: expected a list of overrides without references, got {typed!r:.80}")
    dropped = (*OF_A_RUN, *(OF_A_SCENE if any(word.startswith("scene=") for word in words) else ()))
    kept = [word for word in typed if not f"{_key(word)}.".startswith(tuple(f"{key}." for key in dropped))]
    there = load_config([*kept, *words])
    there.allow_targets = list(allow_targets)
    check_constructors(there)
    return placed(own, there)


def words_of_place(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Overrides of a command line that belong to the place of a run, and all others."""
    mine = [word for word in words if "=" in word and _key(word).partition(".")[0] in PLACE]
    return mine, [word for word in words if word not in mine]


def _key(word: str) -> str:
    """The key of an override, for a group that says where it goes that place: task.motion of motion@task.motion."""
    group, _, place = word.lstrip("+~").partition("=")[0].partition("@")
    return (place or group).replace("/", ".")
