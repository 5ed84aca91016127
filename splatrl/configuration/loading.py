"""Configs composed from overrides: those of a command line, of a call, and of a job of a sweep."""

from collections.abc import Sequence

from hydra import compose
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig

from splatrl.configuration.grammar import last_typed, readable
from splatrl.configuration.scene_choice import with_scene_chosen
from splatrl.configuration.scene_proposals import with_proposals
from splatrl.configuration.search_path import composed
from splatrl.configuration.typed_overrides import check_chosen
from splatrl.configuration.typed_words import check_spelled
from splatrl.files import expanded


def load_config(overrides: Sequence[str] = (), name: str = "train") -> DictConfig:
    """Compose a config as the command line would.

    Args:
        overrides: overrides in Hydra's grammar, such as ``task=fps`` or ``task.max_steps=100``; ``scene=`` also takes a
            path.
        name: name of the root config.

    Raises:
        ValueError: for anything but a list of overrides, or for some that do not fit the configs, in the words of the
            command line.
        HydraException: for overrides that fit no config, and that the command line leaves to Hydra.
    """
    check_texts(overrides)
    words = [readable(override) for override in overrides]
    try:
        return composed(with_scene_paths(words, name), name)
    except HydraException as error:
        refused = error
    check_spelled(name, words)
    check_chosen(name, with_scene_chosen(words, name))
    raise refused


def check_texts(overrides: Sequence[str]) -> None:
    """Refuse anything but a list of texts, such as a single override, with a ValueError."""
    several = isinstance(overrides, Sequence) and not isinstance(overrides, str)
    if not several or not all(isinstance(one, str) for one in overrides):
        raise ValueError(f"overrides: expected a list of texts such as ['task=fps'], got {overrides!r:.80}")


def job_config(cfg: DictConfig, overrides: Sequence[str]) -> DictConfig:
    """Return the config of one job of a sweep, with the proposals of the job's own scene.

    Args:
        cfg: the job's config as Hydra composed it.
        overrides: the job's overrides.
    """
    if not {"scene=file", "scene=yard", "scene=yards", "scene=many"}.intersection(overrides):
        return cfg
    if not GlobalHydra.instance().is_initialized():
        return load_job(overrides)
    hydra = HydraConfig.get()  # it also searches what --config-dir, --config-name and hydra.searchpath name
    search = [override for override in hydra.overrides.hydra if override.startswith("hydra.searchpath=")]
    words = with_scene_paths([readable(override) for override in _alone(overrides)])
    return compose(hydra.job.config_name, [*search, *words])


def load_job(overrides: Sequence[str]) -> DictConfig:
    """Compose the config of a training from its overrides, whether it was a job of a sweep or not.

    Args:
        overrides: the overrides that Hydra recorded; those of a job of a sweep lack what its scene proposed.
    """
    return load_config(_alone(overrides))


def _alone(overrides: Sequence[str]) -> list[str]:
    """Return the overrides of a job of a sweep as they would be typed for one training: a path after ``scene=``."""
    paths = [override for override in overrides if override.startswith("scene.path=")]
    path = expanded(str(last_typed(paths, "scene.path", ""))).absolute()  # not the name of a config
    if "scene=file" not in overrides or not paths or not path.exists():
        return list(overrides)
    return [*(override for override in overrides if override not in ("scene=file", *paths)), f"scene={path}"]


def with_scene_paths(overrides: Sequence[str], name: str = "train") -> list[str]:
    """Rewrite a path after ``scene=`` as ``scene=file scene.path=...``, and add what the scene proposes.

    In a sweep of trainings nothing is added, since a file may sweep over scenes too: each job adds the proposals of
    its own scene (``job_config``).

    The name of a scene's config takes precedence over a file of the same name in the working directory. The proposals
    of a folder's ``scene.yaml`` come before all other overrides, so that anything typed takes precedence over them.

    Args:
        overrides: overrides in Hydra's grammar.
        name: name of the root config.

    Raises:
        ValueError: for a value that looks like a path but does not exist, or for an invalid ``scene.yaml``.
    """
    return with_proposals(with_scene_chosen(overrides, name), name)
