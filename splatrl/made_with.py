"""The scene, files, settings and hardware of a training, and whether another run may resume it."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from splatrl.configuration import differences, paths_of, with_values
from splatrl.files import digest_of, expanded, refusing
from splatrl.motions import Motion
from splatrl.native import _core
from splatrl.physics import mjcf_files
from splatrl.scenes.formats.reading import META

FREE = (
    *("device:", "scene.name:", "scene.paths:", "env.num_envs:", "collector.total_frames:"),
    *("logger.", "checkpoint.", "evaluation."),
)
"""Prefixes of the lines of ``differences`` that are accepted here. Files are identified by their content, and another
number of robots is refused by the training itself, even with ``resume_changed``."""
ANYWAY = "to resume with them anyway, type resume_changed=true"
NOT_DIGESTED = ("scene.path", "demos", "evaluation.episodes")
"""Ends of the keys of paths without a digest: scenes have their own, a checkpoint no longer depends on demonstrations,
and the episodes of evaluations do not concern the training."""


def made_with(cfg: DictConfig, scene_digest: str) -> dict[str, Any]:
    """Return everything that a training's results depend on, as plain values for its checkpoints.

    Args:
        cfg: config of the training.
        scene_digest: digest of the scene's content.
    """
    settings = OmegaConf.to_container(cfg)
    assert isinstance(settings, dict)
    return {
        "settings": settings,
        "scene": scene_digest,
        "files": digests_of(cfg),
        "isa": _core.isa(),
        "threads": cfg.threads,
    }


def actions_of(motion: Motion) -> list[str] | list[list[float]]:
    """Return the names of a motion's discrete actions, or the lowest and highest values of a continuous one."""
    space = motion.action_spec.space
    return list(motion.action_names) or [space.low.tolist(), space.high.tolist()]


def check_actions(path: Path, now: Any, then: Any) -> None:
    """Refuse a policy whose actions a robot cannot take, and warn if they mean something else to it.

    Limits that agree to three digits are the same: an MJCF file may round those of the motion that it takes after.

    Args:
        path: the policy's checkpoint.
        now: ``actions_of`` the robot's motion.
        then: ``actions_of`` the motion with which the policy was trained, which need not be trusted; None if unknown.

    Raises:
        ValueError: for other numbers or kinds of actions, or for something else than actions.
    """
    if then is None:
        return
    with refusing(path, "the actions of a policy"):
        learned, taken = _in_words(then), _in_words(now)
        alike = type(then[0]) is type(now[0]) and len(then) == len(now)
        alike &= isinstance(then[0], str) or len(then[0]) == len(now[0])
    if learned == taken:
        return
    if not alike:
        raise ValueError(
            f"robot, task.motion: expected those of the policy in {path}, whose actions are {learned}, got {taken}"
        )
    warnings.warn(
        f"robot, task.motion: the actions of the policy in {path} were {learned} in training, and now are {taken}",
        stacklevel=3,
    )


def _in_words(actions: Any) -> str:
    """Describe the result of ``actions_of``."""
    if isinstance(actions[0], str):
        return ", ".join(map(str, actions))
    low, high = (", ".join(f"{value:.3g}" for value in limits) for limits in actions)
    return f"[{low}] to [{high}]"


def check_made_with(now: Mapping[str, Any], then: Mapping[str, Any]) -> None:
    """Refuse to resume a training that began with another scene, other settings or files with other content.

    The device, the paths of files, the training's length, the number of robots, which PPO checks, and the settings of
    logging, checkpoints and evaluation may change. If the number of PyTorch threads or the processor's instruction set
    differs, a warning says that results may differ in their last bits.

    Args:
        now: ``made_with`` of the run that is to resume.
        then: ``made_with`` from its checkpoint; empty if there is none.

    Raises:
        ValueError: names the differences, and the setting that resumes nevertheless.
    """
    if not then:
        return
    asked = _with_paths_of(then["settings"], now["settings"])
    changed = [line for line in differences(asked, then["settings"]) if not line.startswith(FREE)]
    changed += changed_content(now, then)
    if changed:
        raise ValueError(
            "resume: expected the scene, settings and files with which the run began, got different ones: "
            + "; ".join([*changed, ANYWAY])
        )
    other = [f"{key} {now[key]} instead of {then[key]}" for key in ("isa", "threads") if now[key] != then[key]]
    if other:
        warnings.warn(f"resume: resuming with {', '.join(other)}; results may differ in the last bits", stacklevel=2)


def changed_content(now: Mapping[str, Any], then: Mapping[str, Any]) -> list[str]:
    """List the scene and the files whose content differs between two results of ``made_with``."""
    changed = [] if now["scene"] == then["scene"] else ["scene: its Gaussians or its free space differ"]
    return changed + [f"{name}: its content differs" for name in changed_files(now["files"], then.get("files", {}))]


def changed_files(now: Mapping[str, str], then: Mapping[str, str]) -> list[str]:
    """List the names of the files whose content differs between two results of ``digests_of``."""
    common = now.keys() & then.keys()  # a new file is told by the setting or the file that refers to it
    other = {name for name in common if now[name] != then[name]}
    # and a folder in place of a file, or of a folder of other files, has no name in common with it
    other |= ({key_of(name) for name in now} & {key_of(name) for name in then}) - {key_of(name) for name in common}
    return sorted(other)


def _with_paths_of(then: Mapping[str, Any], now: Mapping[str, Any]) -> DictConfig:
    """Return settings with the paths that other settings had, wherever both have one."""
    cfg = OmegaConf.create(dict(now))
    asked, before = paths_of(cfg), paths_of(OmegaConf.create(dict(then)))
    return with_values(cfg, {key: path for key, path in before.items() if key in asked})


def digests_of(cfg: DictConfig) -> dict[str, str]:
    """Return digests of the files of a config that results depend on besides the scene, without built-in ones.

    They are named by the key of their path, and those that belong to them by their name beside it: where they are does
    not matter.
    """
    given = {key: expanded(path) for key, path in paths_of(cfg).items() if not key.endswith(NOT_DIGESTED)}
    return {_name(key, path, file): digest_of([file]) for key, path in given.items() for file in files_of(path)}


def _name(key: str, path: Path, file: Path) -> str:
    """Return the name of a file at a key, or of one that belongs to it."""
    return key if file == path else f"{file.relative_to(path if path.is_dir() else path.parent)} of {key}"


def key_of(name: str) -> str:
    """Return the key of a file's name in ``digests_of``."""
    return name.rpartition(" of ")[2]


def files_of(path: Path) -> list[Path]:
    """Return a file and those that belong to it, such as an MJCF's meshes or the images of an unpacked SOG."""
    if path.suffix == ".xml":
        return mjcf_files(path)
    folder = path.parent if path.name == META else path
    return sorted(file for file in folder.iterdir() if file.is_file()) if folder.is_dir() else [path]
