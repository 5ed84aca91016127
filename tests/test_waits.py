"""What people are told while something takes long, and only then."""

import time

import pytest

from splatrl import waits
from splatrl.waits import announced, late_bar


def test_what_takes_long_is_announced(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    with announced("computing quickly"):
        pass
    monkeypatch.setattr(waits, "LONG", 0.0)
    told = [""]
    with announced("computing slowly"):
        while not told[-1] and len(told) < 10_000:
            time.sleep(0.001)
            told.append(capsys.readouterr().err)
    assert told[-1] == "computing slowly\n"


def test_a_bar_appears_only_if_something_takes_long_and_disappears(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for seconds, appears in ((60.0, False), (0.0, True)):
        monkeypatch.setattr(waits, "LONG", seconds)
        with late_bar("try", 2, "time") as bar:
            bar.update(2)
        told = capsys.readouterr().err
        assert ("try:" in told) == appears and (not told or told.endswith(" \r"))
