"""``splatrl-clips``: score trained policies on labelled clips, draw their actions on a film, or record clips."""

from pathlib import Path

import hydra
import torch
from omegaconf import DictConfig, ListConfig

from splatrl.building import build_one_world
from splatrl.building.instantiation import instantiate
from splatrl.commands.entries import clips as main
from splatrl.commands.faults import in_one_line
from splatrl.configuration import check_config, conf_dir, config_elsewhere
from splatrl.evaluation.clips import REPORT, write_report
from splatrl.experiments.clip_scores import Watcher, altered, record_clips
from splatrl.values import require_number

FILMS = "films"
"""Folder in a run folder for films with its policy's actions."""


@hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="clips")
@in_one_line("splatrl-clips")
def run(cfg: DictConfig) -> None:
    """Overlay a film with what the runs of ``cfg.run`` would do, record clips, or score the runs on clips."""
    check_config(cfg)
    runs = [str(one) for one in cfg.run] if isinstance(cfg.run, ListConfig) else [str(cfg.run)]
    if cfg.record is None and cfg.clips is None and cfg.film is None:
        raise ValueError(
            "clips: expected at least one of clips=<a folder>, film=<a video> and record=<a new folder>, got none"
        )
    if len(set(runs)) < len(runs) or not runs:
        raise ValueError(f"run: expected distinct run folders, got {', '.join(runs) or 'none'}")
    if cfg.fov is not None:
        require_number("fov", cfg.fov, 1, 179, unit="degrees")
    loading = (cfg.checkpoint, cfg.device, cfg.allow_targets, cfg.fov, cfg.place)
    if cfg.film is not None:
        film = Path(cfg.film)
        names = [Path(run).absolute().name for run in runs]
        if cfg.out is not None and len(set(names)) < len(names):
            raise ValueError(f"run: expected folders of different names, which name the films, got {', '.join(runs)}")
        for name, last in zip(runs, names, strict=True):
            output = Path(name, FILMS, film.stem) if cfg.out is None else Path(cfg.out, f"{film.stem}-{last}")
            for path in Watcher.of_run(Path(name), *loading).film(film, output):
                print(path)
    if cfg.record is not None:
        own = config_elsewhere(Path(runs[0]), cfg.place, cfg.allow_targets)
        own.device = cfg.device or own.device
        torch.set_num_threads(own.threads)
        world = build_one_world(altered(own, cfg.seed))
        settings = (cfg.count, cfg.seed, cfg.height, instantiate(cfg.hand), instantiate(cfg.lens))
        written = record_clips(world, Path(cfg.record), *settings)
        print(f"{len(written)} clips in {cfg.record}")
    if cfg.clips is not None:
        results = {name: Watcher.of_run(Path(name), *loading).score(Path(cfg.clips)) for name in runs}
        folder = Path(cfg.out or cfg.clips)
        print(write_report(results, folder))
        print(f"{folder / REPORT}.md, {folder / REPORT}.json")


if __name__ == "__main__":
    main()
