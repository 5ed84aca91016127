"""Hydra configs: composing them, checking them, and keeping them in run folders."""

import functools
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import QuotedString
from hydra.errors import HydraException
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from tqdm import tqdm

from splatrl.documents import read_config
from splatrl.files import replacing
from splatrl.native.threads import usable_cores
from splatrl.scene_overrides import scene_overrides
from splatrl.scenes import yards
from splatrl.scenes.description import SCENE_FILE, read_description
from splatrl.scenes.formats.reading import META
from splatrl.scenes.nerfstudio import antialiased_beside
from splatrl.targets import check_targets
from splatrl.values import require_number


@functools.cache
def _new_folder(path: str) -> str:
    """A new folder of this name, or with a number behind it: two runs may begin in the same second."""
    for number in itertools.count(1):
        folder = Path(path if number == 1 else f"{path}-{number}")
        try:
            folder.mkdir(parents=True)
            return str(folder)
        except FileExistsError:
            continue
    raise AssertionError


OmegaConf.register_new_resolver("splatrl.run_dir", lambda resume, fresh: resume or _new_folder(fresh), replace=True)


def conf_dir() -> Path:
    """The folder of the configs: inside the package if it is installed, or beside it in a checkout."""
    package = Path(__file__).parent
    return package / "conf" if (package / "conf").is_dir() else package.parent / "conf"


RUN_CONFIG = "config.yaml"
"""The config of a run, in its folder."""
MOST = 2**31 - 1
WHOLE_NUMBERS = {
    "seed": (0, 2**63 - 1),
    "threads": (1, 1024),
    "env.num_envs": (1, MOST),
    "collector.frames_per_batch": (1, MOST),
    "collector.total_frames": (1, 2**53),
    "logger.test_interval": (1, 2**53),
    "logger.num_test_episodes": (1, MOST),
    "logger.test_seed": (0, 2**63 - 1),
    "checkpoint.interval": (1, 2**53),
    "evaluation.starts": (1, MOST),
    "evaluation.repeats": (1, MOST),
    "evaluation.batch_size": (1, MOST),
    "evaluation.seed": (0, 2**63 - 1),
    "starts.farthest": (0, MOST),
    "renderer.threads": (1, 1024),
}
"""Keys whose values are read here and there rather than by one constructor, and their ranges."""
WORDS = {"evaluation.checkpoint": ("last", "best"), "logger.backend": ("csv", "tensorboard", "wandb")}
"""Keys that take one of a few words, which would otherwise be refused only after a training."""
NULLABLE = ("starts.farthest", "renderer.threads")

BY_SCENE = "or let splatrl-scene <the splat> --out <a folder> find one, and type scene=<the folder>"
EXAMPLES = {
    "run": "run=<the folder of a training>",
    "robot.height": f"robot.height=0.4, metres above the floor, {BY_SCENE}",
    "landmarks.goal": f"landmarks.goal=[x,y,yaw], two in metres and one in degrees, of what sees something, {BY_SCENE}",
    "landmarks.object": f"landmarks.object=[x,y,z], in metres, of a free place for a thing, {BY_SCENE}",
    "scene.path": "scene.path=<a splat file or a folder>",
}
"""What to type for values that people forget."""

PATHS = ("scene.path", "collision.occupancy.cloud", "demos", "evaluation.episodes")
"""Keys that hold a path, which is made absolute in a run folder; numbers are none."""


@contextmanager
def config_loader() -> Iterator[ConfigLoader]:
    """Hydra with our configs and those of the search path's plugins; an already running Hydra is left untouched."""
    instance = GlobalHydra.instance()
    outer = instance.hydra
    instance.clear()
    try:
        with initialize_config_dir(str(conf_dir()), version_base="1.3"):
            yield instance.config_loader()
    finally:
        GlobalHydra.instance().hydra = outer  # the instance has been replaced meanwhile


def load_config(overrides: Sequence[str] = (), name: str = "train") -> DictConfig:
    """Compose a config as the command line does.

    Args:
        overrides: overrides in Hydra's grammar, such as ``task=fps`` or ``task.max_steps=100``; ``scene=`` also takes a
            path.
        name: name of the root config.
    """
    return composed(with_scene_paths(overrides, name), name)


def composed(overrides: Sequence[str], name: str) -> DictConfig:
    """Compose a config of what Hydra itself understands."""
    with config_loader():
        return compose(name, list(overrides))


def with_scene_paths(overrides: Sequence[str], name: str = "train") -> list[str]:
    """Overrides in which a path after ``scene=`` is rewritten as ``scene=file scene.path=...``.

    The name of a scene's config takes precedence over a file of the same name in the working folder. What the
    ``scene.yaml`` of a folder proposes for training in it stands before all other overrides, so that each of them has
    the last word.

    Args:
        overrides: overrides in Hydra's grammar.
        name: name of the root config.

    Raises:
        ValueError: for what looks like a path but does not exist, or for a wrong ``scene.yaml``.
    """
    result: list[str] = []
    for override in overrides:
        key, _, value = override.partition("=")
        path = value.strip("'\"")
        if key == "scene" and path and Path(path).expanduser().exists() and path not in options("scene"):
            _check_scene(Path(path).expanduser())
            result += ["scene=file", f"scene.path={quoted(path)}"]
        elif key == "scene" and Path(path).suffix and "," not in path and path not in options("scene"):
            raise ValueError(f"scene: expected {', '.join(options('scene'))} or a path that exists, got {path}")
        else:
            result.append(override)
    return [*_proposals(result, name), *result, *_places(result, name)]


def place_configs(cfg: DictConfig) -> list[DictConfig]:
    """A config with one scene for each of the scenes of a config; itself where it has only one.

    ``scene.places`` lists what belongs to each: ``scene``, what to build, and values of other keys.
    """
    places = cfg.scene.get("places") if "scene" in cfg and isinstance(cfg.scene, DictConfig) else None
    if not places:
        return [cfg]
    plain = OmegaConf.masked_copy(cfg, [str(key) for key in cfg if key != "scene"])
    result = []
    for place in places:
        merged = OmegaConf.merge(plain, place)
        assert isinstance(merged, DictConfig), type(merged)
        merged.allow_targets = cfg.allow_targets  # a place does not say whom to trust
        result.append(merged)
    return result


def _places(overrides: Sequence[str], name: str) -> list[str]:
    """``scene.places`` for ``scene=yards``, or for what ``scene=many`` lists, as an override; else nothing.

    Each is a folder, a splat file, the name of a scene's config, or that name with a seed: ``yard:3``. What it says
    stands behind what was typed, which holds in all scenes.

    Raises:
        ValueError: for a name that is neither a config nor a path.
    """
    if "scene=yards" in overrides:
        paths = _yard_paths(overrides)
    elif "scene=many" in overrides:
        paths = _typed(overrides, "scene.paths", [])
        if not isinstance(paths, list):
            raise ValueError(f"scene.paths: expected a list such as [garden/,yard:3], got {_text(paths)}")
    else:
        return []
    typed = {override.partition("=")[0] for override in overrides}
    others = [override for override in overrides if not override.startswith(("scene=", "scene."))]
    places = []
    for path in paths:
        text = _text(path)
        chosen = _chosen(text)
        place = _flat(_scene_node(chosen[0].partition("=")[2]))
        for override in [*chosen[1:], *_proposals([*others, *chosen], name)]:
            parsed = OverridesParser.create().parse_override(override)
            value = parsed.value()
            place[parsed.key_or_group] = _text(value) if isinstance(value, QuotedString) else value
        places.append({key: value for key, value in place.items() if key not in typed})
    return [f"scene.places=[{','.join(_nested(place) for place in places)}]"] if places else []


def _yard_paths(overrides: Sequence[str]) -> list[str]:
    """What ``scene=yards`` stands for in ``scene.paths``; the yards are made, side by side, if they are new."""
    usual = _scene_node("yards")["scene"]
    count, first = (_typed(overrides, f"scene.{key}", usual[key]) for key in ("count", "first"))
    require_number("scene.count", count, 1, 2**20, whole=True)
    require_number("scene.first", first, 0, 2**62, whole=True)
    seeds = range(first, first + count)
    made = yards.made_yards(seeds, usable_cores())
    for _ in tqdm(made, "yards", count, unit="yard", dynamic_ncols=True):
        pass
    return [f"yard:{seed}" for seed in seeds]


def _typed(overrides: Sequence[str], key: str, usual: object) -> Any:
    """The last value that was typed for a key, or the usual one."""
    given = [override for override in overrides if override.startswith(f"{key}=")]
    return OverridesParser.create().parse_override(given[-1]).value() if given else usual


def _text(value: object) -> str:
    """A value of Hydra's grammar as text, without quotes."""
    return value.text if isinstance(value, QuotedString) else str(value)


def _chosen(text: str) -> list[str]:
    """Overrides that choose one scene: the group first."""
    known, (config, _, seed) = options("scene"), text.partition(":")
    if config in known and seed.isdigit():
        return [f"scene={config}", f"scene.seed={seed}"]
    if text in known:
        return [f"scene={text}"]
    if not Path(text).expanduser().exists():
        raise ValueError(
            f"scene.paths: expected {', '.join(known)}, one of them with a seed (yard:3), or a path, got {text}"
        )
    _check_scene(Path(text).expanduser())
    return ["scene=file", f"scene.path={quoted(Path(text).expanduser().absolute())}"]


def _scene_node(option: str) -> dict[str, Any]:
    """What the config of a scene says, with references as they are written."""
    with config_loader() as loader:
        for source in loader.get_sources():
            if source.available() and source.is_config(f"scene/{option}"):
                node = OmegaConf.to_container(source.load_config(f"scene/{option}").config, resolve=False)
                assert isinstance(node, dict), type(node)
                return {str(key): value for key, value in node.items()}
    raise AssertionError(option)


def _flat(plain: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted keys and their values."""
    result: dict[str, Any] = {}
    for key, value in plain.items():
        name = f"{prefix}{key}"
        result |= _flat(value, f"{name}.") if isinstance(value, dict) and value else {name: value}
    return result


def _nested(flat: dict[str, Any]) -> str:
    """Dotted keys and their values as a dictionary in Hydra's grammar."""
    tree: dict[str, Any] = {}
    for key, value in flat.items():
        *parents, leaf = key.split(".")
        node = tree
        for parent in parents:
            node = node.setdefault(parent, {})
        node[leaf] = value
    return _hydra_value(tree)


def _hydra_value(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ",".join(f"{key}:{_hydra_value(own)}" for key, own in value.items()) + "}"
    if isinstance(value, list):
        return f"[{','.join(map(_hydra_value, value))}]"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return quoted(value) if isinstance(value, str) else repr(value)


def _check_scene(path: Path) -> None:
    if path.is_dir() and not (path / SCENE_FILE).is_file() and not (path / META).is_file():
        raise ValueError(
            f"scene: expected a splat file, or a folder with {SCENE_FILE}, got {path}; "
            f"splatrl-scene <the splat> --out {path} writes one"
        )


def _proposals(overrides: Sequence[str], name: str) -> list[str]:
    """What the chosen scene's folder, or what lies beside its file, proposes for the chosen task, as overrides."""
    paths = [override for override in overrides if override.startswith("scene.path=")]
    try:
        if "scene=yard" in overrides:
            return scene_overrides(yards.proposals(_yard_seed(overrides)), lambda key: True)
        if "scene=file" not in overrides or not paths:
            return []
        path = OverridesParser.create().parse_override(paths[-1]).value()
        place = Path(path.text if isinstance(path, QuotedString) else str(path)).expanduser()
        stated = read_description(place) if (place / SCENE_FILE).is_file() else {}
        drawn = antialiased_beside(place / stated["splat"] if stated else place)
        if drawn is not None:
            stated.setdefault("antialiased", drawn)
        configs = _choices(overrides, name) if stated else []
    except HydraException:
        return []  # Hydra itself tells what is wrong with the overrides
    return scene_overrides(stated, lambda key: all(_has(cfg, key) for cfg in configs))


def _yard_seed(overrides: Sequence[str]) -> int:
    """The seed of ``scene=yard``, to which its goal belongs."""
    seeds = [override.partition("=")[2] for override in overrides if override.startswith("scene.seed=")]
    if seeds and not re.fullmatch("[0-9]{1,18}", seeds[-1]):
        raise ValueError(
            f"scene.seed: expected one whole number from 0, to which the yard's goal belongs, got {seeds[-1]}"
        )
    return int(seeds[-1]) if seeds else 0


def _has(cfg: DictConfig, key: str) -> bool:
    """Whether a config has a key, with or without a value."""
    parent, _, leaf = key.rpartition(".")
    node = OmegaConf.select(cfg, parent)
    return isinstance(node, DictConfig) and leaf in list(node)  # "in node" leaves out what still has no value


def _choices(overrides: Sequence[str], name: str) -> list[DictConfig]:
    """The configs that the groups of some overrides make, one for each combination of a sweep."""
    plain = [one for one in overrides if "=" in one and not one.startswith(("-", "+", "~", "hydra"))]
    groups = []
    for text, parsed in zip(plain, OverridesParser.create().parse_overrides(plain), strict=True):
        key = text.partition("=")[0]
        if is_group(key):
            swept = parsed.is_sweep_override()
            values = list(parsed.sweep_string_iterator()) if swept else [parsed.get_value_element_as_str()]
            groups.append([f"{key}={value}" for value in values])
    with config_loader():
        return [compose(name, list(chosen)) for chosen in itertools.product(*groups)]


def quoted(value: object) -> str:
    """Quote any value for Hydra's grammar."""
    text = str(value).replace("'", "\\'")
    return f"'{text}'"


def is_group(key: str) -> bool:
    """Whether an override's key names a config group, either ours or a plugin's."""
    return bool(options(key.split("@")[0]))


def options(group: str) -> list[str]:
    """The options of a config group, including those of plugins; empty if there is no such group."""
    with config_loader() as loader:
        return list(loader.get_group_options(group))


def save_config(cfg: DictConfig, folder: Path) -> None:
    """Write ``config.yaml`` into a run folder: everything needed to resume and evaluate, from any working folder."""
    with replacing(folder / RUN_CONFIG) as stream:
        stream.write(OmegaConf.to_yaml(with_absolute_paths(cfg)).encode())


def with_absolute_paths(cfg: DictConfig) -> DictConfig:
    """A config that means the same files from any working folder."""
    cfg = cfg.copy()
    for key in PATHS:
        path = OmegaConf.select(cfg, key)
        if isinstance(path, str):
            OmegaConf.update(cfg, key, str(Path(path).expanduser().absolute()))
    return cfg


def run_config(folder: Path, allow_targets: Sequence[str] = ()) -> DictConfig:
    """The config with which a run folder was made, read as data.

    Args:
        folder: the run folder, which may come from a stranger.
        allow_targets: packages that may define what the config builds; what the folder itself says of them is nothing.

    Raises:
        FileNotFoundError: if the folder is not a run folder.
        ValueError: for a config that is damaged, or names something else to build than what stands in conf/.
    """
    path = folder / RUN_CONFIG
    if not path.is_file():
        raise FileNotFoundError(f"{folder}: expected a run folder with {RUN_CONFIG}, found none")
    cfg = read_config(path)
    try:
        cfg.allow_targets = list(allow_targets)
        _check_sections(cfg, load_config())
        check_constructors(cfg)
    except (OmegaConfBaseException, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
    return cfg


def _check_sections(cfg: DictConfig, usual: DictConfig, place: str = "") -> None:
    """Refuse a config without the sections and settings that are read from it; nodes with a target check their own."""
    for key in usual:
        where = f"{place}.{key!s}".lstrip(".")
        if not place and isinstance(usual[key], DictConfig) and not usual[key]:
            continue  # such as sensors, of which there may be any or none
        if not place and isinstance(usual[key], DictConfig):
            if not isinstance(cfg.get(key), DictConfig):
                raise ValueError(f"{where}: expected keys and values, got {cfg.get(key)!r}")
            if "_target_" not in usual[key]:
                _check_sections(cfg[key], usual[key], where)
        elif key not in list(cfg):
            raise ValueError(f"{where}: expected a value, found no such key")


def resumed_config(folder: Path, overrides: Sequence[str]) -> DictConfig:
    """The config of a run folder, with the changes from the command line.

    Args:
        folder: the run folder.
        overrides: overrides of the command line, including ``resume``.

    Raises:
        ValueError: for an override that chooses a config group, which would make it a different run.
    """
    changes = [o for o in overrides if not o.startswith("resume=")]
    cfg = run_config(folder, OmegaConf.from_dotlist(changes).get("allow_targets", ()))
    groups = [o for o in changes if is_group(o.split("=")[0])]
    if groups:
        raise ValueError(f"resume={folder}: expected changes of single keys, got {', '.join(groups)}")
    merged = OmegaConf.merge(cfg, OmegaConf.from_dotlist(changes))
    assert isinstance(merged, DictConfig), type(merged)
    return merged


def check_constructors(cfg: DictConfig) -> None:
    """Check targets against the configs on our search path, and on that of a Hydra that runs: ``--config-dir``."""
    outer = GlobalHydra.instance().hydra
    with config_loader() as loader:
        check_targets(cfg, loader.get_sources() + ([] if outer is None else outer.config_loader.get_sources()))


def check_config(cfg: DictConfig) -> None:
    """Refuse a config with missing values, or one that would build what is neither known nor allowed.

    Everything that is built passes here first; see ``check_targets``.

    Raises:
        ValueError: names the keys, what was expected and what came.
    """
    if isinstance(OmegaConf.select(cfg, "scene.places"), ListConfig) and not cfg.scene.places:
        raise ValueError("scene.paths: expected some scenes, got none; type scene.paths=[garden/,yard:3]")
    for place in place_configs(cfg):
        check_constructors(place)
        plain = OmegaConf.to_container(place, resolve=False)
        needed = sorted(_missing(plain)) or sorted(_unset_landmarks(plain))
        if needed:
            example = EXAMPLES.get(needed[0], needed[0] + "=...")
            raise ValueError(f"{needed[0]}: expected a value, got none; type {example}")
    for key, (low, high) in WHOLE_NUMBERS.items() if "collector" in cfg else ():  # of a training
        value = OmegaConf.select(cfg, key)
        if value is not None or key not in NULLABLE:
            require_number(key, value, low, high, whole=True)
    for key, valid in WORDS.items() if "collector" in cfg else ():
        if (value := OmegaConf.select(cfg, key)) not in valid:
            raise ValueError(f"{key}: expected one of {', '.join(valid)}, got {value}")


def _missing(node: Any, place: str = "") -> Iterator[str]:
    """Keys of plain values that have to be given."""
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in items:
        where = f"{place}.{key}" if place else str(key)
        if value == "???":
            yield where
        yield from _missing(value, where)


def _unset_landmarks(plain: Any) -> list[str]:
    """Landmarks that the task refers to and that are null."""
    said = str(plain.get("task"))
    names = [f"landmarks.{key}" for key, value in (plain.get("landmarks") or {}).items() if value is None]
    return [name for name in names if f"${{{name}}}" in said]
