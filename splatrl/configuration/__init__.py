"""Hydra configs: composing them from the command line, checking them, and storing them in run folders."""

from splatrl.configuration.checking import check_config, check_constructors, check_values
from splatrl.configuration.command_line import command_line
from splatrl.configuration.differences import differences, differences_from_run, settings_of
from splatrl.configuration.elsewhere import config_elsewhere, moves_scene, placed, says_where, words_of_place
from splatrl.configuration.grammar import quoted
from splatrl.configuration.loading import check_texts, job_config, load_config, with_scene_paths
from splatrl.configuration.places import place_configs, place_names
from splatrl.configuration.run_configs import (
    RUN_CONFIG,
    check_new,
    forget_run,
    resumed_config,
    run_config,
    save_config,
)
from splatrl.configuration.run_files import (
    NAMES_OR_PATHS,
    PATHS,
    check_files,
    paths_of,
    typed_key,
    with_absolute_paths,
    with_values,
)
from splatrl.configuration.search_path import conf_dir, is_group, options
from splatrl.configuration.typed_words import UserError

__all__ = [
    "NAMES_OR_PATHS",
    "PATHS",
    "RUN_CONFIG",
    "UserError",
    "check_config",
    "check_constructors",
    "check_files",
    "check_new",
    "check_texts",
    "check_values",
    "command_line",
    "conf_dir",
    "config_elsewhere",
    "differences",
    "differences_from_run",
    "forget_run",
    "is_group",
    "job_config",
    "load_config",
    "moves_scene",
    "options",
    "paths_of",
    "place_configs",
    "place_names",
    "placed",
    "quoted",
    "resumed_config",
    "run_config",
    "save_config",
    "says_where",
    "settings_of",
    "typed_key",
    "with_absolute_paths",
    "with_scene_paths",
    "with_values",
    "words_of_place",
]
