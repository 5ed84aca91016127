"""``splatrl-replay``: repeat the actions of demonstrations, and check that the results are the same."""

import sys
from pathlib import Path

import hydra
import torch
from omegaconf import DictConfig

from splatrl.building import build_one_world
from splatrl.commands.entries import replay as main
from splatrl.commands.faults import in_one_line
from splatrl.configuration import check_config, conf_dir, config_elsewhere
from splatrl.datasets import read_demonstrations, replay
from splatrl.waits import Bar


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="replay")
@in_one_line("splatrl-replay")
def run(cfg: DictConfig) -> None:
    """Replay the folder ``cfg.demos``; exit with an error if anything other than the views differs."""
    check_config(cfg)
    folder = Path(cfg.demos)
    demonstrations = read_demonstrations(folder)
    own = config_elsewhere(folder, cfg.place, cfg.allow_targets)
    own.device = "cpu"
    torch.set_num_threads(own.threads)
    world = build_one_world(own)
    demonstrations.warn_of_another_scene(world)
    with Bar(total=len(demonstrations), unit="frame", desc="replay") as bar:
        different, views = replay(world, demonstrations, bar.update)
    what = f"{folder}: {len(demonstrations.starts):,} episodes, {len(demonstrations):,} frames"
    if different:
        sys.exit("\n".join([f"splatrl-replay: {what} do not replay as recorded", *different]))
    print(f"{what}: states, actions, rewards and outcomes are identical, byte for byte")
    print(f"views are identical in {views:,} of {len(demonstrations):,} frames")


if __name__ == "__main__":
    main()
