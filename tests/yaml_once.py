"""Parses each YAML text once in a process: Hydra reads forty files anew for every config that it composes."""

import functools
import io
import pickle
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf


def parse_once() -> None:
    """Let ``OmegaConf.load`` remember the texts of open files; each call still gets a config of its own."""
    load = OmegaConf.load

    @functools.cache
    def parsed(text: str | bytes) -> bytes:
        return pickle.dumps(load(io.StringIO(text) if isinstance(text, str) else io.BytesIO(text)))

    @functools.wraps(load)
    def remembered(file: Any) -> Any:
        return load(file) if isinstance(file, str | Path) else pickle.loads(parsed(file.read()))

    OmegaConf.load = staticmethod(remembered)
