"""``splatrl-record``: record demonstrations of a task into a folder."""

import itertools
import signal
from contextlib import suppress
from pathlib import Path

import hydra
import torch
from omegaconf import DictConfig
from tqdm import tqdm

from splatrl.building import build_one_world
from splatrl.commands.entries import record as main
from splatrl.commands.faults import in_one_line
from splatrl.commands.stopping import interrupted_by
from splatrl.configuration import check_config, conf_dir, save_config
from splatrl.datasets import Demonstrations, check_lerobot, planner_episodes, write_demonstrations, write_lerobot
from splatrl.envs.world import World
from splatrl.files import new_folder, require_room
from splatrl.values import require_number
from splatrl.viewer.driver import Takes
from splatrl.viewer.driving import Driving
from splatrl.viewer.keys import keys_of
from splatrl.viewer.page import Page

BY = ("planner", "keys")


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="record")
@in_one_line("splatrl-record")
def run(cfg: DictConfig) -> None:
    """Record demonstrations into the folder ``cfg.out``, together with the config needed to replay them."""
    check_config(cfg)
    if cfg.by not in BY:
        raise ValueError(f"by: expected {' or '.join(BY)}, got {cfg.by}")
    folders = {key: Path(cfg[key]) for key in ("out", "lerobot") if cfg[key] is not None}
    if cfg.lerobot is not None:
        out, other = (folders[key].resolve() for key in ("out", "lerobot"))
        if out.is_relative_to(other) or other.is_relative_to(out):
            raise ValueError(f"lerobot: expected a folder separate from out={cfg.out}, got {cfg.lerobot}")
    for key, path in folders.items():
        if path.exists():
            raise ValueError(f"{key}: expected a new folder, got {path}, which already exists")
        path.parent.mkdir(parents=True, exist_ok=True)
        require_room(path.parent)  # fail now rather than after a person has driven all episodes
    torch.set_num_threads(cfg.threads)
    cfg.device = "cpu"  # so that a replay gives the same bytes on any machine
    world = build_one_world(cfg)
    if cfg.lerobot is not None:
        check_lerobot(world.robot.image_width, world.robot.image_height)
    found = driven(cfg, world) if cfg.by == "keys" else planned(cfg, world)
    folders = {key: untaken(path) for key, path in folders.items()}
    with new_folder(folders["out"]) as folder:
        save_config(cfg, folder)
        write_demonstrations(folder, found, {"by": cfg.by, "seed": cfg.seed})
    if cfg.lerobot is not None:
        task = f"{type(world.task).__name__} in {world.scene.name}"
        with new_folder(folders["lerobot"]) as folder:
            write_lerobot(folder, found, task)
        print(f"{folders['lerobot']}: the same episodes as a LeRobotDataset v3.0")
    print(f"{folders['out']}: {len(found.starts):,} episodes, {len(found):,} frames")


def untaken(path: Path) -> Path:
    """Return a path, with a number appended if another recording has taken the name in the meantime."""
    others = (path.with_name(f"{path.name}-{number}") for number in itertools.count(2))
    return next(one for one in itertools.chain([path], others) if not one.exists())


def planned(cfg: DictConfig, world: World) -> Demonstrations:
    """Record episodes in which the planner chooses the actions."""
    with tqdm(unit="frame", desc="record", dynamic_ncols=True) as bar:
        return planner_episodes(world, cfg.episodes, cfg.seed, bar.update)


def driven(cfg: DictConfig, world: World) -> Demonstrations:
    """Record episodes that a person drives in the browser.

    Recording ends when there are enough episodes, when the person ends it in the browser or by Ctrl-C, or when the
    terminal is closed.
    """
    require_number("episodes", cfg.episodes, 1, 10**6, whole=True)
    keys_of(world.task.motion)  # refuses motions that keys cannot drive, before a page is opened
    page = Page(world.scene, cfg.host, cfg.port)
    print(
        f"{page.address}: drive to the goal {cfg.episodes} times; Ctrl-C saves the episodes recorded so far", flush=True
    )
    try:
        takes = Takes(world)
        driving = Driving(page, world, cfg.seed, takes, cfg.episodes)
        with suppress(KeyboardInterrupt), interrupted_by(signal.SIGTERM, signal.SIGHUP):
            while not driving.finished.wait(1.0):
                pass
        driving.finished.set()  # so that no further episode is added
        return takes.demonstrations()
    finally:
        page.close()


if __name__ == "__main__":
    main()
