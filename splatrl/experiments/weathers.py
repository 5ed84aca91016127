"""Tests of policies in clear weather and in each kind of weather alone, whether or not training included it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from splatrl.building import build_one_world
from splatrl.configuration import load_config, run_config
from splatrl.experiments.experiment import Run
from splatrl.experiments.transfer import tested
from splatrl.waits import Bar

KINDS = ("fog", "dusk", "sun", "rain", "snow", "wet")
WEATHERS: dict[str, tuple[str, ...]] = {"clear": (), **{kind: (kind,) for kind in KINDS}}
"""Kinds of weather, from ``conf/transforms/appearance/weather.yaml``, that every episode of a test has, by name."""


def score_weathers(runs: Sequence[Run], folder: Path) -> list[dict[str, Any]]:
    """Test finished runs in each of ``WEATHERS``, in the scene in which they were trained, over its start set.

    Args:
        runs: finished runs; those in the same scene share task and motion.
        folder: folder of the experiment; nothing is written to it.

    Returns:
        One row per run and weather: ``run`` (name of its folder), ``place`` (scene and weather), ``starts`` and rates.
    """
    configs = {run.folder: run_config(run.folder) for run in runs}
    rows = []
    for weather, kinds in Bar(WEATHERS.items(), unit="weather", desc="weather"):
        worlds = {run.scene: build_one_world(in_weather(configs[run.folder], kinds)) for run in reversed(runs)}
        for run in runs:
            cfg = in_weather(configs[run.folder], kinds)
            rates = tested(run.folder, cfg, worlds[run.scene])
            rows.append({"run": run.folder.name, "place": f"{run.scene}, {weather}", **rates})
    return rows


def in_weather(cfg: DictConfig, kinds: Sequence[str]) -> DictConfig:
    """Change the weather in a run's config: every episode has exactly these kinds; with none, it is clear."""
    cfg = cfg.copy()
    off = [f"transforms.appearance.{kind}=0" for kind in KINDS if kind not in kinds]
    weather = load_config(["transforms/appearance=weather", "transforms.appearance.often=1", *off])
    cfg.transforms.appearance = weather.transforms.appearance if kinds else {}
    cfg.around_drawing = weather.around_drawing if kinds else None
    return cfg
