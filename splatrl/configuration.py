"""Hydra configs: how they are composed, checked, kept in run folders and read again."""

import difflib
import sys
from collections.abc import Sequence
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf

from splatrl.files import replacing
from splatrl.scenes.scene import BACKYARD

OmegaConf.register_new_resolver("splatrl.run_dir", lambda resume, fresh: resume or fresh, replace=True)


def conf_dir() -> Path:
    """The folder of the configs: inside an installed package, or beside it in a checkout."""
    package = Path(__file__).parent
    return package / "conf" if (package / "conf").is_dir() else package.parent / "conf"


def load_config(overrides: Sequence[str] = (), name: str = "train") -> DictConfig:
    """Compose a config as the command line does.

    Args:
        overrides: in Hydra's grammar, such as ``scene=kitchen`` or ``task.max_steps=100``.
        name: of the root config.
    """
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        return compose(name, list(overrides))


def check_overrides(name: str, arguments: Sequence[str]) -> None:
    """Stop with the valid keys when an override names a key that does not exist.

    Hydra itself lists the options of a config group, but not the keys of a node.

    Args:
        name: of the root config.
        arguments: of the command line.

    Raises:
        SystemExit: with a message that names the key, its nearest neighbour and all valid ones.
    """

    def is_group(key: str) -> bool:
        return (conf_dir() / key).is_dir()

    plain = [a for a in arguments if "=" in a and not a.startswith(("-", "+", "~", "hydra"))]
    try:
        keys = [override.key_or_group for override in OverridesParser.create().parse_overrides(plain)]
        groups = [a.split(",")[0] for a, key in zip(plain, keys, strict=True) if is_group(key)]
        known = load_config(groups, name)
    except HydraException:
        return  # Hydra itself tells where the grammar breaks and which options a group has
    for key in keys:
        if is_group(key):
            continue
        *parents, leaf = key.split(".")
        node = OmegaConf.select(known, ".".join(parents)) if parents else known
        valid = [str(k) for k in node if k != "_target_"] if isinstance(node, DictConfig) else []
        if leaf not in valid:
            near = difflib.get_close_matches(leaf, valid, 1)
            hint = f", did you mean {'.'.join([*parents, near[0]])}?" if near else ""
            place = f"of {'.'.join(parents)}" if parents else "at the top"
            sys.exit(f"{key}: no such key{hint}\nvalid keys {place}: {', '.join(valid) or 'none'}")


def save_config(cfg: DictConfig, folder: Path) -> None:
    """Write ``config.yaml`` into a run folder: all that resuming and evaluating need to know, from wherever."""
    cfg = cfg.copy()
    if cfg.scene.path != BACKYARD:
        cfg.scene.path = str(Path(cfg.scene.path).expanduser().absolute())
    with replacing(folder / "config.yaml") as stream:
        stream.write(OmegaConf.to_yaml(cfg).encode())


def run_config(folder: Path) -> DictConfig:
    """The config that a run folder was made with.

    Raises:
        FileNotFoundError: where the folder is not a run folder.
    """
    path = folder / "config.yaml"
    if not path.is_file():
        raise FileNotFoundError(f"{folder}: expected a run folder with config.yaml, found none")
    cfg = OmegaConf.load(path)
    assert isinstance(cfg, DictConfig), type(cfg)
    return cfg


def resumed_config(folder: Path, overrides: Sequence[str]) -> DictConfig:
    """The config of a run folder with the changes that the command line asks for.

    Args:
        folder: the run folder.
        overrides: of the command line, ``resume`` among them.

    Raises:
        ValueError: for an override that picks another config group: that would be another run.
    """
    cfg = run_config(folder)
    changes = [o for o in overrides if not o.startswith("resume=")]
    groups = [o for o in changes if (conf_dir() / o.split("=")[0]).is_dir()]
    if groups:
        raise ValueError(f"resume={folder}: expected changes of single keys, got {', '.join(groups)}")
    merged = OmegaConf.merge(cfg, OmegaConf.from_dotlist(changes))
    assert isinstance(merged, DictConfig), type(merged)
    return merged


def require_values(cfg: DictConfig) -> None:
    """Refuse a config in which a value is still to be given.

    Raises:
        ValueError: names the keys.
    """
    missing = sorted(OmegaConf.missing_keys(cfg))
    if missing:
        raise ValueError(f"expected a value for {', '.join(missing)}; give it as {missing[0]}=...")
