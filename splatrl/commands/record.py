"""``splatrl-record``: record demonstrations of a task into a folder."""

import sys
from pathlib import Path

import hydra
import torch
from omegaconf import DictConfig
from tqdm import tqdm

from splatrl.build import build_world
from splatrl.configuration import check_config, command_line, conf_dir, save_config
from splatrl.datasets import planner_episodes, write_demonstrations
from splatrl.files import new_folder

BY = ("planner",)


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="record")
def run(cfg: DictConfig) -> None:
    """Record what a config describes into the folder ``cfg.out``."""
    try:
        record(cfg)
    except (OSError, ValueError) as error:
        sys.exit(f"splatrl-record: {error}")


def record(cfg: DictConfig) -> None:
    """Record demonstrations, and write them with the config with which they are replayed."""
    check_config(cfg)
    if cfg.by not in BY:
        raise ValueError(f"by: expected {' or '.join(BY)}, got {cfg.by}")
    out = Path(cfg.out).expanduser()
    if out.exists():
        raise ValueError(f"out: expected a new folder, but {out} is there")
    torch.set_num_threads(cfg.threads)
    cfg.device = "cpu"  # so that a replay gives the same bytes anywhere
    world = build_world(cfg)
    with tqdm(unit="frame", desc="record", dynamic_ncols=True) as bar:
        found = planner_episodes(world, cfg.episodes, cfg.seed, bar.update)
    out.parent.mkdir(parents=True, exist_ok=True)
    with new_folder(out) as folder:
        save_config(cfg, folder)
        write_demonstrations(folder, found, {"by": cfg.by, "seed": cfg.seed, "scene": world.scene.digest})
    print(f"{out}: {len(found.starts):,} episodes, {len(found):,} frames")


def main() -> None:
    """Entry point of the command."""
    sys.argv[1:] = command_line("record", sys.argv[1:])
    run()


if __name__ == "__main__":
    main()
