"""``splatrl-view``: view a scene or a run in the browser, move its goal and bounds, and drive a robot in it."""

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from splatrl.building import build_one_world, check_place
from splatrl.building.instantiation import instantiate
from splatrl.commands.entries import view as main
from splatrl.commands.faults import in_one_line
from splatrl.configuration import (
    check_config,
    check_constructors,
    check_files,
    conf_dir,
    config_elsewhere,
    place_configs,
)
from splatrl.configuration.scene_overrides import CORNERS, TARGETS
from splatrl.envs.world import World
from splatrl.evaluation.scene_pictures import survey_occupancy
from splatrl.files import expanded
from splatrl.runs import TrainedPolicy, load_policy
from splatrl.scenes.description import SCENE_FILE
from splatrl.scenes.scene import Scene
from splatrl.values import one_line
from splatrl.viewer.driving import Driving
from splatrl.viewer.markdown import plain
from splatrl.viewer.page import Page
from splatrl.viewer.placing import Placing
from splatrl.viewer.rollout import Rollout


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="view")
@in_one_line("splatrl-view")
def run(cfg: DictConfig) -> None:
    """Serve the page until Ctrl-C."""
    if cfg.run is None:
        if cfg.place:
            raise ValueError(f"place: expected a run with it, got {list(cfg.place)} alone")
        check_constructors(cfg)
        own, trained = cfg, None
    else:
        own, trained = config_of_run(cfg, HydraConfig.get().overrides.task)
    if (count := len(place_configs(own))) > 1 or "_target_" not in own.scene:
        raise ValueError(f"scene: expected one scene for this command, got {count}; type scene=<one of them>")
    if own.scene.get("path", "") is None or OmegaConf.is_missing(own.scene, "path"):
        check_config(own)
    check_files(own)
    torch.set_num_threads(own.threads)
    page = Page(instantiate(own.scene), cfg.host, cfg.port)
    print(f"{page.address}: {page.scene.name}, {len(page.scene.gaussians):,} Gaussians; Ctrl-C to quit", flush=True)
    with ExitStack() as ending:
        ending.callback(page.close)
        try:
            ending.callback(furnish(page, own, trained))  # a thread still in PyTorch would abort the interpreter's exit
            print("the page is ready", flush=True)
            _wait()
        except KeyboardInterrupt:
            print()


def config_of_run(cfg: DictConfig, typed: Sequence[str]) -> tuple[DictConfig, Callable[[World], TrainedPolicy]]:
    """Return the config of the run folder ``cfg.run``, and a function that loads its policy into a world.

    Args:
        cfg: config of the command; with ``place``, the run is moved there.
        typed: the overrides that were typed for the command.
    """
    folder, words = Path(cfg.run), list(cfg.place)
    own = config_elsewhere(folder, words, cfg.allow_targets)
    own.device = own.device if cfg.device == "auto" else cfg.device
    if any(word.startswith("evaluation.checkpoint=") for word in typed):
        own.evaluation.checkpoint = cfg.evaluation.checkpoint
    return own, lambda world: load_policy(folder, cfg=own, world=world, place=words)


def furnish(
    page: Page, cfg: DictConfig, trained: Callable[[World], TrainedPolicy] | None = None
) -> Callable[[], object]:
    """Fill a page with everything its config allows: policy, driving and placing.

    Args:
        page: the page, which shows the scene already.
        cfg: config of a training or a run.
        trained: loads a policy into the world; None shows no policy.

    Returns:
        A function that stops whatever still runs.
    """
    scene, gui = page.scene, page.server.gui
    folder = _folder(cfg)
    if folder is not None:
        page.show_path(folder)
    try:
        world = build_one_world(cfg)
    except ValueError as error:
        if trained is not None:
            raise
        print(f"driving is not available: {one_line(error)}", flush=True)
        gui.add_markdown(f"Driving is not available: {plain(one_line(error))}")
        page.show_occupancy(survey_occupancy(scene))
        return lambda: None
    page.show_occupancy(world.occupancy)
    page.show_free(world.plan)
    tabs, stop = gui.add_tab_group(), []
    if trained is not None:
        with tabs.add_tab("policy"):
            rollout = Rollout(page, trained(world))
            rollout.start()
            stop.append(rollout.stop)
    with tabs.add_tab("drive"):
        try:
            Driving(page, world)
        except ValueError as error:
            gui.add_markdown(f"Driving is not available: {plain(one_line(error))}")
    with tabs.add_tab("place"):
        Placing(page, world, place_values(cfg, scene), folder, lambda stated: _check(cfg, scene, stated))
    return lambda: [each() for each in stop]


def place_values(cfg: DictConfig, scene: Scene) -> dict[str, Any]:
    """Return the values that can be dragged, ``goal``, ``object``, ``walk`` and ``bounds``, as in a ``scene.yaml``."""
    corners = [OmegaConf.select(cfg, key) for key in CORNERS]
    values: dict[str, Any] = {"bounds": [list(corner) for corner in scene.bounds]}
    values["walk"] = None if None in corners else [[float(value) for value in corner] for corner in corners]
    for key in ("goal", "object"):
        value = OmegaConf.select(cfg, TARGETS[key][0])
        values[key] = None if value is None else [float(number) for number in value]
    return values


def _folder(cfg: DictConfig) -> Path | None:
    """Return the scene's folder if it has a ``scene.yaml``; None for single files and generated scenes."""
    path = cfg.scene.get("path")
    folder = None if path is None else expanded(path)
    return folder if folder is not None and (folder / SCENE_FILE).is_file() else None


def _check(cfg: DictConfig, scene: Scene, stated: Mapping[str, Any]) -> None:
    """Raise ``ValueError`` if the config's task does not fit the values stated for a ``scene.yaml``."""
    changed = cfg.copy()
    for key in ("goal", "object"):
        OmegaConf.update(changed, TARGETS[key][0], stated.get(key, OmegaConf.select(cfg, TARGETS[key][0])))
    for target, corner in zip(CORNERS, stated.get("walk", ()), strict=False):
        OmegaConf.update(changed, target, corner)
    lower, upper = stated.get("bounds", scene.bounds)
    check_place(changed, (tuple(lower), tuple(upper)))


def _wait() -> None:
    """Block until Ctrl-C."""
    forever = threading.Event()
    while not forever.wait(1.0):
        pass


if __name__ == "__main__":
    main()
