"""What people are told while something takes long, and only then."""

import io
import sys
import time

import pytest

from splatrl import waits
from splatrl.waits import Bar, announced, late_bar


class Terminal(io.StringIO):
    """What is written to a terminal."""

    def isatty(self) -> bool:
        return True

    def shown(self) -> list[str]:
        """Return the lines that are to be seen, without blank ones; the cursor moves as it does on a terminal."""
        rows, row, column = [""], 0, 0
        for part in self.getvalue().replace("\x1b[A", "\x0b"):
            if part == "\x0b":
                row -= 1
            elif part == "\r":
                column = 0
            elif part == "\n":
                row, column = row + 1, 0
                rows += [""] * (row == len(rows))
            else:
                rows[row] = rows[row][:column].ljust(column) + part + rows[row][column + 1 :]
                column += 1
        return [line.rstrip() for line in rows if line.strip()]


def terminal_of(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Show on a terminal what is written to stderr from now on."""
    found = Terminal()
    monkeypatch.setattr(sys, "stderr", found)
    return found


def wait_for(told: str, terminal: Terminal) -> None:
    """Wait until something has been written."""
    for _ in range(10_000):
        if told in terminal.getvalue():
            return
        time.sleep(0.001)
    raise AssertionError(terminal.getvalue())


def test_what_takes_long_is_announced(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = terminal_of(monkeypatch)
    with announced("computing quickly"):
        pass
    monkeypatch.setattr(waits, "LONG", 1e-9)
    with announced("computing slowly"):
        wait_for("slowly\n", terminal)
    assert terminal.getvalue() == "computing slowly\n"


def test_an_announcement_has_a_line_of_its_own_above_bars(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = terminal_of(monkeypatch)
    with Bar(total=2, desc="scenes") as bar, late_bar("too early", 2, "time"):
        monkeypatch.setattr(waits, "LONG", 1e-9)
        with announced("computing levels"):
            wait_for("levels\n", terminal)
        bar.update(2)
    first, second = terminal.shown()
    assert first == "computing levels" and second.startswith("scenes: 100%")
    assert "too early" not in terminal.getvalue()


def test_a_bar_appears_only_if_something_takes_long_and_disappears(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = terminal_of(monkeypatch)
    for seconds, appears in ((60.0, False), (1e-9, True)):
        monkeypatch.setattr(waits, "LONG", seconds)
        with Bar(total=2, desc="train") as above, late_bar("try", 2, "time") as bar:
            bar.refresh()
            above.update(2)
        assert ("try:" in terminal.getvalue()) == appears
    assert [line.partition(":")[0] for line in terminal.shown()] == ["train", "train"]


def test_a_log_has_a_line_now_and_then_and_one_at_the_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with Bar(total=2, desc="train") as bar, late_bar("test", 2, "episode") as below:
        for _ in range(2):
            bar.update()
            bar.set_postfix(level=1)
            below.update()
            Bar.write("computing levels", sys.stderr)
    told = capsys.readouterr().err
    *above, last = told.splitlines()
    assert above == ["computing levels"] * 2 and last.startswith("train: 100%") and last.endswith("level=1]")
    assert "\r" not in told
    monkeypatch.setattr(waits, "SELDOM", 0.0)
    with Bar(total=2, desc="train") as bar, late_bar("test", 2, "episode") as below:
        bar.set_postfix(level=1)
        below.refresh()
        bar.update()
    told = capsys.readouterr().err
    assert [line.partition(":")[0] for line in told.splitlines()] == ["train", "train", "test", "train"]
    assert "\r" not in told and "\x1b" not in told


def test_a_bar_that_never_moved_is_not_left_above_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="none"), Bar(total=2, desc="record"):
        raise ValueError("none")
    assert capsys.readouterr().err == ""


def test_a_notebook_draws_bars_in_place(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "ipykernel", sys)
    with Bar(total=2, desc="train"):
        pass
    assert capsys.readouterr().err.count("\r") > 1
