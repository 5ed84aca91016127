"""The config of a run: stored in its folder, read back as untrusted data, and changed when the run is resumed."""

import functools
import itertools
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Override
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict, read_write
from omegaconf.errors import OmegaConfBaseException

from splatrl.configuration.checking import check_constructors
from splatrl.configuration.grammar import overrides_parser, quoted
from splatrl.configuration.known_keys import has_key
from splatrl.configuration.run_files import set_value, with_absolute_paths
from splatrl.configuration.search_path import composed, is_group
from splatrl.documents import read_config
from splatrl.files import replacing, require_room


@functools.cache
def _new_folder(path: str, key: str) -> str:
    """Make a new folder, with a number appended if it exists already: two runs or sweeps may begin in the same second.

    Args:
        path: the folder.
        key: the key that chooses another one.
    """
    for number in itertools.count(1):
        folder = Path(path if number == 1 else f"{path}-{number}")
        try:
            folder.mkdir(parents=True)
            return str(folder)
        except FileExistsError:
            continue
        except OSError as error:
            _refuse(folder, error, key)
    raise AssertionError


def _refuse(folder: Path, error: OSError, key: str | None) -> NoReturn:
    """Exit with one line: Hydra makes folders before the command itself runs, and would print a traceback.

    Args:
        folder: the folder that cannot be written to.
        error: why it cannot.
        key: the key that chooses another folder; None for a resumed run, which stays in its own.
    """
    told = f"{folder}: cannot write: {os.strerror(error.errno or 0)}"
    told += f"; choose another folder with {key}=" if key else ""
    sys.exit(f"splatrl-{HydraConfig.get().job.name}: {told}")


class WritableFolder(Callback):
    """Hydra callback that ends a run or sweep with one line if its folder cannot be written to."""

    def on_run_start(self, config: DictConfig, **kwargs: object) -> None:
        """Make the folder of a run."""
        self._make(config, "run")

    def on_multirun_start(self, config: DictConfig, **kwargs: object) -> None:
        """Make the folder of a sweep."""
        self._make(config, "sweep")

    def _make(self, config: DictConfig, kind: str) -> None:
        if config.hydra.output_subdir is None:  # a command without run folders
            return
        HydraConfig.instance().set_config(config)  # needed to resolve the folder; Hydra sets it as a job begins
        try:
            folder = Path(config.hydra[kind].dir)
            if kind == "run" and not config.get("resume"):
                check_new(folder)  # before Hydra overwrites what was typed for a run that is there
            folder.mkdir(parents=True, exist_ok=True)
            require_room(folder, FIRST_BYTES)
            if kind == "sweep":
                _share(config, folder)
        except ValueError as error:
            sys.exit(f"splatrl-{config.hydra.job.name}: {error}")
        except OSError as error:
            _refuse(folder, error, None if kind == "run" and config.get("resume") else f"hydra.{kind}.dir")


def _share(config: DictConfig, folder: Path) -> None:
    """Let the jobs of a sweep use one folder: each is composed anew from the overrides, maybe by another process."""
    with read_write(config.hydra), open_dict(config.hydra):
        config.hydra.sweep.dir = str(folder)
        config.hydra.overrides.hydra.append(f"hydra.sweep.dir={quoted(folder)}")


def _run_dir(resume: str | None, fresh: str) -> str:
    """Resolve the folder of a run; it is created only when a job runs, not while a config is merely composed."""
    return resume if resume else (_new_folder(fresh, "hydra.run.dir") if HydraConfig.initialized() else fresh)


def _sweep_dir(fresh: str) -> str:
    """Resolve the folder of a sweep, which is created likewise."""
    return _new_folder(fresh, "hydra.sweep.dir") if HydraConfig.initialized() else fresh


def _typed_dir(resume: str | None) -> str | None:
    """Resolve the sub-folder for Hydra's records, which never replace those of a run that is there.

    A resumed run has another one, and a job of a sweep in the folder of an earlier one, which has the same settings or
    is refused, has none.
    """
    if resume:
        return ".hydra/resumed"
    hydra = HydraConfig.get() if HydraConfig.initialized() else None
    if hydra is None or hydra.mode != RunMode.MULTIRUN or OmegaConf.is_missing(hydra.runtime, "output_dir"):
        return ".hydra"
    return None if (Path(hydra.runtime.output_dir) / RUN_CONFIG).exists() else ".hydra"


OmegaConf.register_new_resolver("splatrl.run_dir", _run_dir, replace=True)
OmegaConf.register_new_resolver("splatrl.sweep_dir", _sweep_dir, replace=True)
OmegaConf.register_new_resolver("splatrl.typed_dir", _typed_dir, replace=True)
RUN_CONFIG = "config.yaml"
"""File name of the config in a run folder."""
FIRST_BYTES = 2**16
"""Least free space for a run, in bytes: its configs, which Hydra writes before the command begins."""


def save_config(cfg: DictConfig, folder: Path) -> None:
    """Write ``config.yaml`` into a run folder: all that is needed to resume and evaluate from any working directory."""
    with replacing(folder / RUN_CONFIG) as stream:
        stream.write(OmegaConf.to_yaml(with_absolute_paths(cfg)).encode())


def check_new(folder: Path) -> None:
    """Refuse a folder in which a training has already saved a checkpoint, with a ValueError."""
    if any(folder.glob("checkpoints/*.pt")):
        raise ValueError(f"hydra.run.dir: expected a new folder, got a run folder; continue it with resume={folder}")


def forget_run(folder: Path) -> None:
    """Remove the files of a run that was refused before it began, and the folders that are then empty."""
    typed = [folder / ".hydra" / f"{name}.yaml" for name in ("config", "hydra", "overrides")]
    empty = [path for path in folder.glob("*.log") if path.stat().st_size == 0]
    for path in (*typed, *empty, folder / RUN_CONFIG):
        path.unlink(missing_ok=True)
    with suppress(OSError):  # a folder that is not empty stays
        for path in (folder / ".hydra", folder / "checkpoints", folder):
            if path.exists():
                path.rmdir()


def run_config(folder: Path, allow_targets: Sequence[str] = ()) -> DictConfig:
    """Read the config of a run folder as data, without trusting it.

    Args:
        folder: the run folder, which may come from an untrusted source.
        allow_targets: packages that may define what the config builds; the folder's own ``allow_targets`` is ignored.

    Raises:
        FileNotFoundError: if the folder is not a run folder.
        ValueError: for a config that is damaged, or that would build something not in conf/ nor allowed.
    """
    path = folder / RUN_CONFIG
    if not path.is_file():
        raise FileNotFoundError(f"{folder}: expected a run folder with {RUN_CONFIG}, found none")
    cfg = read_config(path)
    try:
        cfg.allow_targets = list(allow_targets)
        _check_sections(cfg, composed([], "train"))
        check_constructors(cfg)
    except (OmegaConfBaseException, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
    return cfg


def _check_sections(cfg: DictConfig, usual: DictConfig, place: str = "") -> None:
    """Refuse a config that lacks sections or settings; nodes with a ``_target_`` are checked by their constructor."""
    for key in usual:
        where = f"{place}.{key!s}".lstrip(".")
        if isinstance(usual[key], DictConfig) and not usual[key]:
            continue  # such as sensors or transforms.latency, which may hold anything or nothing
        if not place and isinstance(usual[key], DictConfig):
            if not isinstance(cfg.get(key), DictConfig):
                raise ValueError(f"{where}: expected keys and values, got {cfg.get(key)!r}")
            if "_target_" not in usual[key]:
                _check_sections(cfg[key], usual[key], where)
        elif key not in list(cfg):
            raise ValueError(f"{where}: expected a value, found no such key")


WHERE = ("resume", "launcher")
"""What may be typed for a resumption besides its changes: where the run is, and where a sweep's jobs run."""


def resumed_config(folder: Path, overrides: Sequence[str]) -> DictConfig:
    """Return the config of a run folder with the changes from the command line applied.

    Args:
        folder: the run folder.
        overrides: overrides of the command line, including ``resume``.

    Raises:
        ValueError: for an override that chooses a config group, which would make it a different run, that deletes a
            key, whose key the run does not have, or for ``scene.paths`` other than those of the run's own scenes.
    """
    typed = overrides_parser().parse_overrides(list(overrides))
    changes = [one for one in typed if one.key_or_group not in WHERE]
    cfg = run_config(folder, typed_targets(changes))
    groups = [str(one.input_line) for one in changes if is_group(one.key_or_group)]
    if groups:
        raise ValueError(
            f"resume={folder}: expected overrides of single keys, not of config groups, got {', '.join(groups)}"
        )
    cfg.resume_changed = cfg.view = False  # each resumption has to ask for these itself
    for change in changes:
        if change.is_delete() or not has_key(cfg, change.key_or_group):
            got = str(change.input_line).lstrip("+")
            raise ValueError(f"resume={folder}: expected values for keys of the run, got {got}")
        set_value(cfg, change.key_or_group, change.value())
    return cfg


def typed_targets(overrides: Sequence[Override]) -> list[str]:
    """Return the packages that were typed for ``allow_targets``."""
    given = [one.value() for one in overrides if one.key_or_group == "allow_targets" and not one.is_sweep_override()]
    return [str(package) for package in given[-1]] if given and isinstance(given[-1], list) else []
