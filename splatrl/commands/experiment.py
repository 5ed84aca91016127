"""``splatrl-experiment``: run all trainings of an experiment, and report the results."""

import difflib
import re
import shlex
import sys
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import hydra
from hydra.errors import HydraException
from hydra.utils import get_method
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from splatrl.commands.entries import experiment as main
from splatrl.commands.faults import in_one_line
from splatrl.commands.stopping import stoppable
from splatrl.configuration import UserError, conf_dir, load_config, quoted
from splatrl.experiments import (
    Run,
    Selection,
    budget,
    check_settings,
    checked,
    planned,
    report_all,
    score,
    statement,
    train_all,
)
from splatrl.experiments.machine import machine
from splatrl.native.threads import usable_cores
from splatrl.values import require_number

TRAIN = (sys.executable, "-m", "splatrl.commands.train")
REFERENCE = re.compile(r"\$\{(\w+)\}")
"""A reference to another key, such as ``${kitchen}``."""


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="experiment")
@in_one_line("splatrl-experiment")
def run(cfg: DictConfig) -> None:
    """Train and report the experiment ``cfg.name``, or all experiments."""
    with stoppable(f"continue with: {shlex.join(['splatrl-experiment', *sys.argv[1:]])}"):
        experiment(cfg)


def experiment(cfg: DictConfig) -> None:
    """Train, score and report the experiments that a config asks for.

    Args:
        cfg: the config composed from ``conf/experiment.yaml``.

    Raises:
        ValueError: for an invalid name, scene or setting.
        SystemExit: if trainings failed, once all others are done; the message names them.
    """
    _check(cfg)
    names, folder = _names(cfg), Path(cfg.folder)
    if cfg.report_only and not any((folder / name).is_dir() for name in names):
        raise ValueError(f"folder: expected a folder with finished trainings of {', '.join(names)}, got {folder}")
    nodes = {name: checked(name, _plain(cfg.experiments)[name]) for name in names}
    named = _named(cfg, nodes)
    _prepare(cfg, nodes)
    scenes = _scenes(cfg, named)
    places = None if cfg.scenes is None else [_scene_name(str(scene)) for scene in cfg.scenes]
    selection = Selection(_plain(cfg)["seeds"], cfg.frames, places)
    experiments = [planned(name, nodes[name], scenes, folder, _compose, selection) for name in names]
    runs = [each for asked in experiments for each in asked.runs]
    if not runs:
        raise ValueError(f"name={cfg.name}: expected at least one training, got none with these seeds and scenes")
    jobs, cores = cfg.jobs or usable_cores(), usable_cores()
    failed: list[Run] = []
    if not cfg.report_only:
        check_settings(runs, cfg.fresh)
        left_out = [line for asked in experiments for line in asked.left_out]
        stated = statement([budget(asked) for asked in experiments], min(jobs, len(runs)))
        print("\n".join([*left_out, stated]), flush=True)
        failed = train_all(experiments, jobs, max(1, cores // jobs), TRAIN)
    reports = report_all(experiments, folder, machine(jobs))
    methods = {} if cfg.report_only else {name: node["score"] for name, node in nodes.items()}
    scored = [score(each, get_method(methods[each.name])) for each in experiments if methods.get(each.name)]
    if any(scored):
        reports = report_all(experiments, folder, machine(jobs))
    print("\n".join(f"report: {path}" for path in reports))
    if failed:
        sys.exit("\n".join(["failed:", *(f"{each.folder}: see log.txt there" for each in failed)]))


def _check(cfg: DictConfig) -> None:
    """Refuse settings on which every training would fail in turn."""
    for key in ("jobs", "frames"):
        if cfg[key] is not None:
            require_number(key, cfg[key], 1, whole=True)
    seeds = _plain(cfg)["seeds"]
    if seeds is not None and not (isinstance(seeds, list) and all(type(seed) is int for seed in seeds)):
        raise ValueError(f"seeds: expected whole numbers in brackets such as [0,1], got {seeds}")
    if seeds is not None and len(set(seeds)) < len(seeds):
        raise ValueError(f"seeds: expected different ones, got {seeds}")
    if cfg.scenes is not None and not cfg.scenes:
        raise ValueError("scenes: expected at least one, got none")
    if cfg.kitchen is not None and not cfg.report_only and not Path(cfg.kitchen).exists():
        raise ValueError(f"kitchen: expected the path of an existing kitchen.spz, got {cfg.kitchen}")


def _names(cfg: DictConfig) -> list[str]:
    names = [str(name) for name in cfg.experiments]
    given = None if OmegaConf.is_missing(cfg, "name") else cfg.name
    if given != "all" and given not in names:
        near = difflib.get_close_matches(str(given).lower(), names, 1)
        hint = f"; did you mean name={near[0]}?" if near else ""
        raise ValueError(f"name: expected one of {', '.join([*names, 'all'])}, got {given or 'nothing'}{hint}")
    return names if given == "all" else [given]


def _prepare(cfg: DictConfig, nodes: Mapping[str, Any]) -> None:
    """Run the preparation step of each experiment that has one, such as making a scene that does not exist yet."""
    given = {str(scene): _overrides(cfg, str(scene)) for scene in cfg.scene_overrides}
    for name, node in nodes.items():
        if node["prepare"] and not cfg.report_only:
            known = {scene: overrides for scene, overrides in given.items() if overrides is not None}
            get_method(node["prepare"])(Path(cfg.folder) / name, known)


def _named(cfg: DictConfig, nodes: Mapping[str, Any]) -> set[str]:
    """Return the scenes that arms of the experiments name.

    Raises:
        ValueError: for an arm that names an unknown scene.
    """
    scenes = set()
    for name, node in nodes.items():
        for key, arm in node["arms"].items():
            for scene in arm["scenes"]:
                if scene not in cfg.scene_overrides:
                    raise ValueError(
                        f"experiments.{name}.arms.{key}.scenes: expected names from {', '.join(cfg.scene_overrides)}, "
                        f"got {scene}; define it by '+scene_overrides.{scene}=[\"scene=<its path>\"]'"
                    )
                scenes.add(scene)
    return scenes


def _overrides(cfg: DictConfig, scene: str) -> list[str] | None:
    """Return the overrides of a scene; None if they need the path of a file that was not given."""
    written = OmegaConf.to_container(cfg.scene_overrides[scene], resolve=False)
    if any(cfg[key] is None for key in REFERENCE.findall(str(written))):
        return None
    return [str(override) for override in cfg.scene_overrides[scene]]


def _scene_name(scene: str) -> str:
    """Return a scene's name; one given as a path is named after its folder or file."""
    return Path(scene).resolve().stem if "/" in scene or Path(scene).suffix else scene


def _scenes(cfg: DictConfig, named: Collection[str]) -> dict[str, list[str]]:
    """Collect the overrides of the scenes in which to train; scenes whose files are missing are left out.

    These are the scenes that are typed, or else those that arms name.

    Raises:
        ValueError: for a requested scene that is unknown and does not exist as a path, or whose file is missing.
    """
    known = [str(scene) for scene in cfg.scene_overrides]
    result: dict[str, list[str]] = {}
    for scene in map(str, cfg.scenes or (scene for scene in known if scene in named)):
        if scene not in known:
            if not Path(scene).exists():
                raise ValueError(f"scenes: expected names from {', '.join(known)}, or existing paths, got {scene}")
            name = _scene_name(scene)
            if name in known or name in result:
                raise ValueError(f"scenes={scene}: expected a unique name, got {name} twice; rename the folder")
            path = str(Path(scene).absolute())
            result[name] = ["scene=file", f"scene.path={quoted(path)}", f"device={cfg.device}"]
            continue
        overrides = _overrides(cfg, scene)
        fault = f"type {scene}=<path of its file>" if overrides is None else _absent(overrides)
        if fault is None and overrides is not None:
            result[scene] = overrides
        elif cfg.scenes is not None:
            raise ValueError(f"scenes={scene}: expected a scene that exists, found none; {fault}")
        else:
            print(f"{scene} is left out; to include it, {fault}", file=sys.stderr)
    return result


def _absent(overrides: Sequence[str]) -> str | None:
    """Return how to make a scene's missing folder; None if the folder exists or the scene has none."""
    paths = [override.removeprefix("scene=") for override in overrides if override.startswith("scene=")]
    missing = next((path for path in paths if "/" in path and not Path(path).exists()), None)
    return f"make {missing} first (splatrl-experiment name=loop makes recaptured)" if missing else None


def _compose(overrides: Sequence[str]) -> dict[str, Any]:
    try:
        return _plain(load_config(overrides))
    except (HydraException, OmegaConfBaseException, UserError) as error:
        raise ValueError(f"{' '.join(overrides)}: {error}") from error


def _plain(cfg: DictConfig) -> dict[str, Any]:
    result = cast(Mapping[str, Any], OmegaConf.to_container(cfg))
    return dict(result)


if __name__ == "__main__":
    main()
