"""Lets Hydra compose configs in less time: for each, it would parse and merge forty files anew."""

import functools
import io
import pickle
from pathlib import Path
from typing import Any

from hydra._internal import defaults_list
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from omegaconf import OmegaConf

SHIPPED = {"pkg://hydra.conf", "structured://", f"file://{Path(__file__).parents[1] / 'conf'}"}
"""Where configs come from that no test changes."""


def parse_once() -> None:
    """Let ``OmegaConf.load`` remember the texts of open files; each call still gets a config of its own. Let Hydra
    gather what defaults may refer to only where one of them does, not for each of the forty files, and merge the same
    files once: a command composes one config twice, to learn whether it runs once or several times, and to run."""
    load, gather = OmegaConf.load, defaults_list._create_interpolation_map
    merge, merged = ConfigLoaderImpl._compose_config_from_defaults_list, dict[str, bytes]()

    @functools.cache
    def parsed(text: str | bytes) -> bytes:
        return pickle.dumps(load(io.StringIO(text) if isinstance(text, str) else io.BytesIO(text)))

    @functools.wraps(load)
    def remembered(file: Any) -> Any:
        return load(file) if isinstance(file, str | Path) else pickle.loads(parsed(file.read()))

    def gathered(overrides: Any, defaults: Any, self_added: bool) -> Any:
        return gather(overrides, defaults, self_added) if any(each.is_interpolation() for each in defaults) else None

    def merged_once(self: Any, defaults: list[Any], repo: Any) -> Any:
        if not {source.full_path() for source in repo.get_sources()} <= SHIPPED:
            return merge(self, defaults, repo)  # files that a test may change
        key = repr([(each, each.override_key) for each in defaults])
        if key not in merged:
            merged[key] = pickle.dumps(merge(self, defaults, repo))
        return pickle.loads(merged[key])

    ConfigLoaderImpl._compose_config_from_defaults_list = merged_once
    OmegaConf.load = staticmethod(remembered)
    defaults_list._create_interpolation_map = gathered
