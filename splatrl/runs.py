"""Loads the policy of a run folder and the world in which it was trained."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.modules import ActorValueOperator

from splatrl.building import build_model, build_world
from splatrl.configuration import (
    check_files,
    moves_scene,
    paths_of,
    run_config,
    says_where,
    typed_key,
    with_absolute_paths,
    words_of_place,
)
from splatrl.envs.world import World, Worlds
from splatrl.files import refusing
from splatrl.made_with import actions_of, changed_files, check_actions, digests_of, key_of
from splatrl.training import load_checkpoint
from splatrl.training.history import unpacked

CHECKPOINTS = ("last", "best")


@dataclass(frozen=True)
class TrainedPolicy:
    """A trained policy with the config and world of its run.

    Attributes:
        cfg: config of the run.
        world: world built from it.
        model: actor and critic with the checkpoint's weights.
        checkpoint: content of the checkpoint: ``ppo``, ``history`` (a list of rows), ``best`` and ``seconds``.
    """

    cfg: DictConfig
    world: World | Worlds
    model: ActorValueOperator
    checkpoint: dict[str, Any]

    @property
    def policy(self) -> TensorDictModuleBase:
        """The policy as a module that reads an observation and writes ``action``."""
        return self.model.get_policy_operator()

    def beginning(self) -> TensorDictBase:
        """Return the first observation of an episode of one robot, [1]."""
        return self.world.env(1).reset()


def load_policy(
    run: str | Path,
    checkpoint: str | None = None,
    device: str | None = None,
    cfg: DictConfig | None = None,
    world: World | Worlds | None = None,
    allow_targets: Sequence[str] = (),
    place: Sequence[str] | None = None,
) -> TrainedPolicy:
    """Load the policy of a run folder, which need not be trusted: it is read as data, and builds only what conf/ names.

    Args:
        run: the run folder.
        checkpoint: last or best; None takes the run's own setting.
        device: auto, cpu or cuda; None takes the run's own setting.
        cfg: config of the run, if it has already been read or changed.
        world: world built from ``cfg``, if it has already been built.
        allow_targets: additional packages that may define what the config builds.
        place: the overrides with which ``cfg`` was made; see ``config_elsewhere``. None, where none can be typed,
            warns of files with other contents than in training, and does not compare those of a given ``world``.

    Raises:
        FileNotFoundError: if the folder holds no run, or the checkpoint does not exist.
        ValueError: for a damaged checkpoint, for a robot that takes other actions than the policy's, if ``place`` says
            where the scene has been moved and another is there, or if the content of a file that it does not name
            differs from the one in training.
    """
    run = Path(run)
    cfg = run_config(run, allow_targets) if cfg is None else cfg
    chosen = checkpoint or cfg.evaluation.checkpoint
    if chosen not in CHECKPOINTS:
        raise ValueError(f"checkpoint: expected {' or '.join(CHECKPOINTS)}, got {chosen!r}")
    cfg.device = device or cfg.device
    path = run / "checkpoints" / f"{chosen}.pt"
    state = load_checkpoint(path)
    then, compared, words = state.get("made_with", {}), world is None or place is not None, place or ()
    if compared:
        _check_files(path, cfg, then, place)
    world = build_world(cfg) if world is None else world
    check_actions(path, actions_of(world.task.motion), then.get("actions"))
    if compared and then.get("scene", world.digest) != world.digest:
        if moves_scene(words):
            raise ValueError(
                f"{' '.join(words)}: expected the training's own scenes, in their order, where they are now, got "
                "others or other contents; type scene=... to go elsewhere"
            )
        if not words_of_place(words)[0]:
            warnings.warn(f"scene: its content differs from what the policy of {path} was trained with", stacklevel=2)
    if chosen == "last" and not state.get("prepared", True):
        warnings.warn(
            f"{path}: the training was stopped before it had learned a batch or was through with imitation, so this "
            "policy is as good as untrained; splatrl-train resume=... continues the training",
            stacklevel=2,
        )
    model = build_model(cfg, world.env(1))
    with refusing(path, "the weights of the policy that the run's config describes"):
        model.load_state_dict(state["ppo"]["model"])
    with refusing(path, "the history of a training"):
        state["history"] = unpacked(state.get("history", {}))
    return TrainedPolicy(cfg, world, model, state)


def _check_files(path: Path, cfg: DictConfig, then: Mapping[str, Any], place: Sequence[str] | None) -> None:
    """Refuse files with other contents than in the training of a checkpoint, and warn of those that were typed.

    Args:
        path: the checkpoint.
        cfg: config with which the policy is loaded.
        then: ``made_with`` from the checkpoint; empty if there is none.
        place: see ``load_policy``.
    """
    cfg, before = with_absolute_paths(cfg), paths_of(OmegaConf.create(dict(then.get("settings", {}))))
    check_files(cfg)
    files = paths_of(cfg)
    for name in changed_files(digests_of(cfg), then.get("files", {})):
        key = key_of(name)
        told = f"{name}: its content differs from what the policy of {path} was trained with"
        if place is None or says_where(place, typed_key(key)):
            warnings.warn(told, stacklevel=3)
        elif files[key] == before.get(key):  # or else the file belongs to the place that was typed
            raise ValueError(f"{told}; to use it as it is, type {typed_key(key)}={files[key]}")
