"""Hydra configs: composing them from the command line, checking them, and storing them in run folders."""

from splatrl.configuration.checking import check_config, check_constructors
from splatrl.configuration.command_line import UserError, command_line
from splatrl.configuration.elsewhere import config_elsewhere, placed, words_of_place
from splatrl.configuration.grammar import quoted
from splatrl.configuration.places import place_configs, place_names
from splatrl.configuration.run_configs import (
    PATHS,
    RUN_CONFIG,
    check_new,
    forget_run,
    paths_of,
    resumed_config,
    run_config,
    save_config,
    with_absolute_paths,
)
from splatrl.configuration.scene_choice import job_config, load_config, with_scene_paths
from splatrl.configuration.search_path import conf_dir, is_group, options

__all__ = [
    "PATHS",
    "RUN_CONFIG",
    "UserError",
    "check_config",
    "check_constructors",
    "check_new",
    "command_line",
    "conf_dir",
    "config_elsewhere",
    "forget_run",
    "is_group",
    "job_config",
    "load_config",
    "options",
    "paths_of",
    "place_configs",
    "place_names",
    "placed",
    "quoted",
    "resumed_config",
    "run_config",
    "save_config",
    "with_absolute_paths",
    "with_scene_paths",
    "words_of_place",
]
