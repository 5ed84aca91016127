"""``splatrl-record``: record demonstrations of a task into a folder."""

import itertools
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path

import hydra
import torch
from omegaconf import DictConfig

from splatrl.building import build_one_world, repeats_of
from splatrl.building.instantiation import instantiate
from splatrl.commands.entries import record as main
from splatrl.commands.faults import in_one_line
from splatrl.commands.stopping import handled, interrupted_by
from splatrl.configuration import check_config, check_files, conf_dir, place_configs, save_config, with_absolute_paths
from splatrl.datasets import (
    Demonstrations,
    check_lerobot,
    check_single_steps,
    planner_episodes,
    teacher_episodes,
    write_demonstrations,
    write_lerobot,
)
from splatrl.envs.tasks.module import TaskModule
from splatrl.envs.world import World
from splatrl.files import alone_in, new_folder, require_room
from splatrl.made_with import made_with
from splatrl.values import one_line, require_number
from splatrl.viewer.driving import Driving
from splatrl.viewer.keys import keys_of
from splatrl.viewer.page import Page
from splatrl.viewer.takes import Takes
from splatrl.waits import Bar

SCRIPTED = {"planner": planner_episodes, "teacher": teacher_episodes}
BY = (*SCRIPTED, "keys")
PAUSE = 10.0
"""Time after which a recording that could not be written is written again, seconds."""


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="record")
@in_one_line("splatrl-record")
def run(cfg: DictConfig) -> None:
    """Record demonstrations into the folder ``cfg.out``, together with the config needed to replay them."""
    check_config(cfg)
    if cfg.by not in BY:
        raise ValueError(f"by: expected {', '.join(SCRIPTED)} or keys, got {cfg.by}")
    require_number("episodes", cfg.episodes, 1, 10**6, whole=True)
    folders = {key: Path(cfg[key]) for key in ("out", "lerobot") if cfg[key] is not None}
    if cfg.lerobot is not None:
        out, other = (folders[key].resolve() for key in ("out", "lerobot"))
        if out.is_relative_to(other) or other.is_relative_to(out):
            raise ValueError(f"lerobot: expected a folder separate from out={cfg.out}, got {cfg.lerobot}")
    for key, path in folders.items():
        if path.exists():
            takes = takes_of(folders["out"])
            left = f"; remove it if it is of the interrupted recording in {takes}" if takes.is_dir() else ""
            raise ValueError(f"{key}: expected a new folder, got {path}, which already exists{left}")
        path.parent.mkdir(parents=True, exist_ok=True)
        require_room(path.parent)  # fail now rather than after a person has driven all episodes
    torch.set_num_threads(cfg.threads)
    cfg.device = "cpu"  # so that a replay gives the same bytes on any machine
    check_demonstrator(cfg)  # building the world takes long
    world = build_one_world(cfg)
    if cfg.lerobot is not None:
        check_lerobot(world.robot.image_width, world.robot.image_height)
    if cfg.by in SCRIPTED:
        found = scripted(cfg, world)
        for key, path in folders.items():
            print(write(cfg, world, found, key, path))
        return
    with driven(cfg, world) as found:
        for key, path in reversed(folders.items()):  # out last: while it is missing, the takes are not forgotten
            told = patiently(partial(write, cfg, world, found, key, path))
            with suppress(OSError):  # the terminal may be closed, and the next folder is to be written all the same
                print(told)


def check_demonstrator(cfg: DictConfig) -> None:
    """Refuse a task that ``cfg.by`` cannot demonstrate; no scene is built yet.

    Raises:
        ValueError: names the ways to demonstrate the task that there are.
    """
    check_files(cfg)
    task = instantiate(place_configs(cfg)[0].task)
    if cfg.by == "keys":
        keys_of(task.motion)
        return
    ways = {}
    if task.goals_for_success is None and type(task).reached is not TaskModule.reached:
        ways["planner"] = "by=planner records shortest paths"
    if task.teaches:
        ways["teacher"] = "by=teacher records the task's own teacher"
    if cfg.by in ways:
        if cfg.by == "teacher":
            check_single_steps(task, repeats_of(cfg), "by=teacher")
        return
    with suppress(ValueError):
        keys_of(task.motion)
        ways["keys"] = "by=keys records what you drive"
    needed = {"planner": "a task whose episodes end at goal states", "teacher": "a task with a teacher of its own"}
    told = f"by={cfg.by}: expected {needed[cfg.by]}, got {type(task).__name__}"
    raise ValueError("; ".join([told, *ways.values()]))


def write(cfg: DictConfig, world: World, found: Demonstrations, key: str, path: Path) -> str:
    """Write demonstrations into a new folder, ``out`` or ``lerobot``, and return a line that says so."""
    path = untaken(path)
    with new_folder(path) as folder:
        if key == "lerobot":
            about = f"{type(world.task).__name__} in {world.scene.name}"
            write_lerobot(folder, found, about, controls=world.task.motion.controls)
            return f"{path}: the same episodes as a LeRobotDataset v3.0"
        save_config(cfg, folder)
        write_demonstrations(folder, found, {"by": cfg.by, "seed": cfg.seed})
        return f"{path}: {len(found.starts):,} episodes, {len(found):,} frames"


def patiently(write: Callable[[], str]) -> str:
    """Write what a person has recorded and nobody can record again, as often as it takes, such as on a full disk.

    Returns:
        What ``write`` returns.

    Raises:
        KeyboardInterrupt: if the person gives up.
    """
    while True:
        try:
            return write()
        except OSError as error:
            again = f"the episodes are kept, and written in {PAUSE:.0f} seconds if there is room; Ctrl-C ends this"
            with suppress(OSError):  # the terminal may be closed
                print(f"splatrl-record: {one_line(error)}; {again}", file=sys.stderr)
            with handled(signal.default_int_handler, signal.SIGINT, signal.SIGTERM):
                time.sleep(PAUSE)


def takes_of(out: Path) -> Path:
    """Return the folder, beside ``out``, of the episodes that a person has driven while recording goes on."""
    return Path(f"{out}.takes")


def untaken(path: Path) -> Path:
    """Return a path, with a number appended if another recording has taken the name in the meantime."""
    others = (path.with_name(f"{path.name}-{number}") for number in itertools.count(2))
    return next(one for one in itertools.chain([path], others) if not one.exists())


def scripted(cfg: DictConfig, world: World) -> Demonstrations:
    """Record episodes in which the planner or the task's teacher chooses the actions."""
    with Bar(total=cfg.episodes, unit="episode", desc="record") as bar:
        return SCRIPTED[cfg.by](world, cfg.episodes, cfg.seed, bar.update)


@contextmanager
def driven(cfg: DictConfig, world: World) -> Iterator[Demonstrations]:
    """Record episodes that a person drives in the browser; no signal interrupts the block, which writes them.

    Recording ends when there are enough episodes, when the person ends it in the browser or by Ctrl-C, or when the
    terminal is closed. Until the block succeeds, each episode has a file of its own in a folder beside ``cfg.out``,
    from which the same command continues after a kill.
    """
    folder, enough = takes_of(Path(cfg.out)), threading.Event()
    enough.set()
    folder.mkdir(exist_ok=True)
    with alone_in(folder):
        takes = Takes(world, folder, made_with(with_absolute_paths(cfg), world.digest))
        if takes.episodes:
            print(f"{folder}: continuing after {len(takes.episodes)} episodes of an interrupted recording", flush=True)
        try:
            done = len(takes.episodes) >= cfg.episodes
            with nullcontext(enough) if done else on_page(cfg, world, takes) as finished:
                with suppress(KeyboardInterrupt), interrupted_by(signal.SIGTERM, signal.SIGHUP):
                    while not finished.wait(1.0):
                        pass
                with handled(signal.SIG_IGN, signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                    finished.set()  # so that no further episode is added
                    yield takes.demonstrations()
                    takes.forget()
        finally:
            if not takes.episodes:
                takes.forget()


@contextmanager
def on_page(cfg: DictConfig, world: World, takes: Takes) -> Iterator[threading.Event]:
    """Let a person drive in the browser during the block; yields the event that ends the recording."""
    page = Page(world.scene, cfg.host, cfg.port)
    print(
        f"{page.address}: drive to the goal {cfg.episodes} times; Ctrl-C saves the episodes recorded so far", flush=True
    )
    try:
        yield Driving(page, world, cfg.seed + len(takes.episodes), takes, cfg.episodes).finished
    finally:
        page.close()


if __name__ == "__main__":
    main()
