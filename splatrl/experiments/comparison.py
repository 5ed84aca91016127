"""A comparison of trainings that are not an experiment's: run folders, grouped into arms by their settings."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from splatrl.configuration import RUN_CONFIG, settings_of
from splatrl.configuration.elsewhere import TYPED
from splatrl.documents import read_config, read_yaml
from splatrl.experiments.experiment import Experiment, Run
from splatrl.experiments.folders import finished, history
from splatrl.experiments.results import success_in_tests
from splatrl.files import refusing

ALIKE = ("seed", "device", "logger.", "checkpoint.")
"""Beginnings of the keys in which trainings of one arm may differ."""
SCENE = "scene."
"""Beginning of the keys that say which scene it is."""
OTHERWISE, ALONE = "defaults", "the only arm"
"""Labels of an arm for which nothing was typed that others lack, and of the only arm in a scene."""
MARKS, THRESHOLD = 3, 0.95
"""Number of tests for which the report gives the success, and the success whose first test it looks for."""


def run_folders(given: Sequence[Path]) -> list[Path]:
    """Find the run folders among some folders and in them, as in those of sweeps.

    Raises:
        FileNotFoundError: for a folder that does not exist, or that neither is nor contains one; names it.
    """
    result = dict[Path, None]()
    for folder in given:
        found = [path.parent for path in folder.rglob(RUN_CONFIG) if (path.parent / "checkpoints").is_dir()]
        if not found:
            raise FileNotFoundError(f"{folder}: expected a run folder, or a folder that contains some, found none")
        result |= dict.fromkeys(path.resolve() for path in found)
    return sorted(result, key=lambda path: (str(path.parent), len(path.name), path.name))  # 9 before 10


def compared(folders: Sequence[Path], out: Path) -> Experiment:
    """Make an experiment of trainings that exist already.

    Trainings with the same settings but for the seed, the device and what they log are one arm. It is called by what
    was typed for it and not for all in its scene; where that does not tell arms apart, also by the settings in which
    they differ.

    Args:
        folders: the run folders.
        out: folder of the report.

    Raises:
        ValueError: if no training is finished, or for a damaged file; names it.
    """
    runs, left_out = list[Run](), list[str]()
    known = dict[tuple[str, int], Path]()
    configs = {folder: read_config(folder / RUN_CONFIG) for folder in folders}
    settings = {folder: _settings(folder, config) for folder, config in configs.items()}
    arms = {folder: str(sorted(map(str, own.items()))) for folder, own in settings.items()}
    scenes = _scene_names(configs, settings)
    labels = _labels(settings, arms, scenes)
    for folder in folders:
        config, arm = configs[folder], arms[folder]
        with refusing(folder / RUN_CONFIG, "the config of a training"):
            config.logger.video, seed = False, int(config.seed)  # a film makes no training finished
            run = Run(scenes[folder], arm, labels[folder], seed, folder, (), config)
            done = finished(run)
        if not done:
            left_out.append(f"{folder} is left out: it is not finished, or not evaluated.")
        elif (arm, seed) in known:
            left_out.append(f"{folder} is left out: it is the same training as {known[arm, seed]}.")
        else:
            known[arm, seed] = folder
            runs.append(run)
    if not runs:
        raise ValueError(f"{folders[0].parent}: expected at least one finished training, found none")
    runs.sort(key=lambda run: [run.scene, list(arms.values()).index(run.arm), run.seed])
    tests = sorted({frames for run in runs for frames, _ in success_in_tests(history(run.folder))})
    chosen = [tests[-(-(number + 1) * len(tests) // MARKS) - 1] for number in range(MARKS)] if tests else []
    title = "Comparison of trainings"
    marks = list(dict.fromkeys(chosen))
    return Experiment("comparison", title, None, None, 1.0, 0.0, marks, THRESHOLD, out, tuple(runs), tuple(left_out))


def _settings(folder: Path, config: DictConfig) -> dict[str, Any]:
    """Return the settings of a training in which those of its arm agree, by dotted key."""
    with refusing(folder / RUN_CONFIG, "the config of a training"):
        return {key: value for key, value in settings_of(config).items() if not key.startswith(ALIKE)}


def _words(folder: Path) -> list[str]:
    """Return what was typed for a training, if that is known."""
    words = read_yaml(folder / TYPED) if (folder / TYPED).exists() else []
    return [str(word) for word in words] if isinstance(words, list) else []


def _scene_names(configs: Mapping[Path, DictConfig], settings: Mapping[Path, Mapping[str, Any]]) -> dict[Path, str]:
    """Return the name of each training's scene, which trainings share if and only if they share its settings."""
    own = {
        folder: {key.removeprefix(SCENE): value for key, value in each.items() if key.startswith(SCENE)}
        for folder, each in settings.items()
    }
    kinds = {folder: str(sorted(map(str, each.items()))) for folder, each in own.items()}
    first = {kinds[folder]: folder for folder in reversed(list(kinds))}
    told = _told_apart(
        {kind: _scene(folder, configs[folder]) for kind, folder in first.items()},
        {kind: {key: own[folder][key] for key in own[folder] if key != "places"} for kind, folder in first.items()},
    )
    return {folder: told[kind] for folder, kind in kinds.items()}


def _scene(folder: Path, config: DictConfig) -> str:
    """Name a scene by its file or folder or, of a generated one, as it is typed."""
    with refusing(folder / RUN_CONFIG, "the config of a training"):
        scene = config.scene
        if places := scene.get("places"):
            return f"{len(places)} scenes"
        if path := scene.get("path"):
            return Path(str(path)).name
        name, seed = str(scene["_target_"]).rpartition(".")[2], scene.get("seed")
        return f"{name}:{seed}" if seed else name


def _labels(
    settings: Mapping[Path, Mapping[str, Any]], arms: Mapping[Path, str], scenes: Mapping[Path, str]
) -> dict[Path, str]:
    """Return the label of each training's arm, which no other arm in its scene has."""
    result = dict[tuple[str, str], str]()
    for scene in dict.fromkeys(scenes.values()):
        first = {arms[folder]: folder for folder in reversed(list(arms)) if scenes[folder] == scene}  # names its arm
        own = {arm: settings[folder] for arm, folder in first.items()}
        words = {arm: _words(folder) for arm, folder in first.items()}
        shared = {word for each in words.values() for word in each if _is_shared(word, list(words.values()), own)}
        typed = {
            arm: ", ".join(word for word in each if _tells(word) and word not in shared) for arm, each in words.items()
        }
        for arm, label in _told_apart(typed, own).items():
            result[scene, arm] = label or (OTHERWISE if len(first) > 1 else ALONE)
    return {folder: result[scenes[folder], arm] for folder, arm in arms.items()}


def _told_apart(names: Mapping[str, str], settings: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Return names that all differ: to those that are alike, the settings in which these differ are added."""
    result = dict[str, str]()
    for one, name in names.items():
        alike = [settings[other] for other in names if names[other] == name]
        keys = sorted({key for own in alike for key in own})
        more = [key for key in keys if len({str(own.get(key)) for own in alike}) > 1]
        result[one] = ", ".join(filter(None, [name, *(f"{key}={settings[one].get(key)}" for key in more)]))
    return result


def _is_shared(word: str, words: Sequence[Sequence[str]], settings: Mapping[str, Mapping[str, Any]]) -> bool:
    """Return whether a word was typed for all arms, or sets a key to the value that it has in all of them."""
    key = word.lstrip("+~").partition("=")[0]
    return all(word in each for each in words) or (
        all(key in own for own in settings.values()) and len({str(own[key]) for own in settings.values()}) == 1
    )


def _tells(word: str) -> bool:
    """Return whether a typed word says what an arm is; its scene and its frames are told apart from it."""
    return not word.lstrip("+~").startswith((*ALIKE, "scene", "hydra.", "collector.total_frames="))
