"""The config of a run: kept in its folder, read as data, changed where the run goes on."""

import functools
import itertools
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from splatrl.configuration.checking import check_constructors
from splatrl.configuration.scene_choice import load_config
from splatrl.configuration.search_path import is_group
from splatrl.documents import read_config
from splatrl.files import replacing, require_room


@functools.cache
def _new_folder(path: str) -> str:
    """A new folder of this name, or with a number behind it: two runs may begin in the same second."""
    for number in itertools.count(1):
        folder = Path(path if number == 1 else f"{path}-{number}")
        try:
            folder.mkdir(parents=True)
            return str(folder)
        except FileExistsError:
            continue
        except OSError as error:
            _refuse(folder, error, "hydra.run.dir")
    raise AssertionError


def _refuse(folder: Path, error: OSError, key: str) -> NoReturn:
    """End with a line; Hydra asks for folders before a command begins, and would print where in itself."""
    told = f"{folder}: cannot write: {os.strerror(error.errno or 0)}; say where to write by {key}="
    sys.exit(f"splatrl-{HydraConfig.get().job.name}: {told}")


class WritableFolder(Callback):
    """What Hydra calls before a run or a sweep: ends it with a line where its folder cannot be written to."""

    def on_run_start(self, config: DictConfig, **kwargs: object) -> None:
        """Make the folder of a run."""
        self._make(config, "run")

    def on_multirun_start(self, config: DictConfig, **kwargs: object) -> None:
        """Make the folder of a sweep."""
        self._make(config, "sweep")

    def _make(self, config: DictConfig, kind: str) -> None:
        if config.hydra.output_subdir is None:  # a command without a folder of runs
            return
        hydra = HydraConfig.instance()
        before = hydra.cfg
        hydra.set_config(config)  # as Hydra does a moment later
        try:
            folder = Path(config.hydra[kind].dir)
            folder.mkdir(parents=True, exist_ok=True)
            require_room(folder, FIRST_BYTES)
        except OSError as error:
            _refuse(folder, error, f"hydra.{kind}.dir")
        finally:
            hydra.cfg = before


def _run_dir(resume: str | None, fresh: str) -> str:
    """The folder of a run, which is made when a run asks for it, and not while its config is composed."""
    return resume or (_new_folder(fresh) if HydraConfig.initialized() else fresh)


def _typed_dir(resume: str | None) -> str:
    """Where Hydra keeps what was typed, in the folder of a run: what it began with stays when it is resumed."""
    return ".hydra/resumed" if resume else ".hydra"


OmegaConf.register_new_resolver("splatrl.run_dir", _run_dir, replace=True)
OmegaConf.register_new_resolver("splatrl.typed_dir", _typed_dir, replace=True)
RUN_CONFIG = "config.yaml"
"""The config of a run, in its folder."""
FIRST_BYTES = 2**16
"""What a run needs at least: its configs, which Hydra writes before a command begins."""
PATHS = ("scene.path", "collision.occupancy.cloud", "demos", "evaluation.episodes")
"""Keys that hold a path, which is made absolute in a run folder; numbers are none."""


def save_config(cfg: DictConfig, folder: Path) -> None:
    """Write ``config.yaml`` into a run folder: everything needed to resume and evaluate, from any working folder."""
    with replacing(folder / RUN_CONFIG) as stream:
        stream.write(OmegaConf.to_yaml(with_absolute_paths(cfg)).encode())


def forget_run(folder: Path) -> None:
    """Remove a run that was refused before it began from its folder, and the folder where nothing else is in it."""
    typed = [folder / ".hydra" / f"{name}.yaml" for name in ("config", "hydra", "overrides")]
    empty = [path for path in folder.glob("*.log") if path.stat().st_size == 0]
    for path in (*typed, *empty, folder / RUN_CONFIG):
        path.unlink(missing_ok=True)
    with suppress(OSError):  # what is not empty stays
        for path in (folder / ".hydra", folder / "checkpoints", folder):
            if path.exists():
                path.rmdir()


def with_absolute_paths(cfg: DictConfig) -> DictConfig:
    """A config that means the same files from any working folder; itself where it does so already."""
    given = {key: OmegaConf.select(cfg, key) for key in PATHS}
    absolute = {key: str(Path(path).expanduser().absolute()) for key, path in given.items() if isinstance(path, str)}
    changed = {key: path for key, path in absolute.items() if path != given[key]}
    if changed:
        cfg = cfg.copy()
        for key, path in changed.items():
            OmegaConf.update(cfg, key, path)
    return cfg


def run_config(folder: Path, allow_targets: Sequence[str] = ()) -> DictConfig:
    """The config with which a run folder was made, read as data.

    Args:
        folder: the run folder, which may come from a stranger.
        allow_targets: packages that may define what the config builds; what the folder itself says of them is nothing.

    Raises:
        FileNotFoundError: if the folder is not a run folder.
        ValueError: for a config that is damaged, or names something else to build than what stands in conf/.
    """
    path = folder / RUN_CONFIG
    if not path.is_file():
        raise FileNotFoundError(f"{folder}: expected a run folder with {RUN_CONFIG}, found none")
    cfg = read_config(path)
    try:
        cfg.allow_targets = list(allow_targets)
        _check_sections(cfg, load_config())
        check_constructors(cfg)
    except (OmegaConfBaseException, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
    return cfg


def _check_sections(cfg: DictConfig, usual: DictConfig, place: str = "") -> None:
    """Refuse a config without the sections and settings that are read from it; nodes with a target check their own."""
    for key in usual:
        where = f"{place}.{key!s}".lstrip(".")
        if isinstance(usual[key], DictConfig) and not usual[key]:
            continue  # such as sensors or transforms.latency, of which there may be any or none
        if not place and isinstance(usual[key], DictConfig):
            if not isinstance(cfg.get(key), DictConfig):
                raise ValueError(f"{where}: expected keys and values, got {cfg.get(key)!r}")
            if "_target_" not in usual[key]:
                _check_sections(cfg[key], usual[key], where)
        elif key not in list(cfg):
            raise ValueError(f"{where}: expected a value, found no such key")


def resumed_config(folder: Path, overrides: Sequence[str]) -> DictConfig:
    """The config of a run folder, with the changes from the command line.

    Args:
        folder: the run folder.
        overrides: overrides of the command line, including ``resume``.

    Raises:
        ValueError: for an override that chooses a config group, which would make it a different run.
    """
    changes = [o for o in overrides if not o.startswith("resume=")]
    cfg = run_config(folder, OmegaConf.from_dotlist(changes).get("allow_targets", ()))
    groups = [o for o in changes if is_group(o.split("=")[0])]
    if groups:
        raise ValueError(f"resume={folder}: expected changes of single keys, got {', '.join(groups)}")
    merged = OmegaConf.merge(cfg, OmegaConf.from_dotlist(changes))
    assert isinstance(merged, DictConfig), type(merged)
    return merged
