"""Imports of packages that may be missing."""

import math
import sys
from pathlib import Path

import pytest

from splatrl.extras import install_hint, require


def test_a_module_that_is_there_is_returned() -> None:
    assert require("math", "view") is math


def test_a_missing_module_is_named_with_the_command_that_installs_it() -> None:
    with pytest.raises(ImportError) as caught:
        require("no_such.module", "view")
    assert str(caught.value) == "no_such.module is missing: pip install 'splatrl[view]'"


def test_the_error_states_the_problem_and_the_advice_that_it_was_given() -> None:
    with pytest.raises(ImportError) as caught:
        require("no_such_module", "capture", "markers need OpenCV", ", or use none")
    assert str(caught.value) == install_hint("capture", "markers need OpenCV", ", or use none")
    assert str(caught.value) == "markers need OpenCV: pip install 'splatrl[capture]', or use none"


def test_the_error_for_a_broken_module_gives_the_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_module.py").write_text("from math import no_such_function")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ImportError, match=r"^broken_module is missing: pip install .* \(cannot import name 'no_such_"):
        require("broken_module", "view")
    assert "broken_module" not in sys.modules
