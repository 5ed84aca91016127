"""A fixture that the tests of benchmarks share."""

import importlib
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A function that imports a module of benchmarks/ by name."""
    monkeypatch.syspath_prepend(FOLDER)
    return importlib.import_module
