"""Programs from the preloaded interpreter behave like those that ``python`` itself starts."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.preloaded import start

TELLS = """
import atexit, os, sys, threading
atexit.register(print, "at exit")
print(__name__, sys.argv, os.getcwd(), os.environ.get("TOLD"), threading.active_count())
print(len(os.listdir("/proc/self/fd")))
print("an error", file=sys.stderr, flush=True)
sys.exit(3)
"""


def test_a_program_behaves_like_one_that_python_itself_starts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    words, env = ["-c", TELLS, "one", "two words"], os.environ | {"TOLD": "this"}
    expected = subprocess.run(
        [sys.executable, *words],
        env=env,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    program = start(*words, env=env)
    assert program.communicate(60) == (expected.stdout, None)
    assert program.returncode == expected.returncode == program.wait() == 3


def test_a_module_is_run_as_the_main_module() -> None:
    program = start("-m", "timeit", "-n", "1", "-r", "1", "import __main__; print(__main__.__spec__.name)")
    assert program.communicate(60)[0].startswith("timeit\n1 loop")
    assert program.returncode == 0


def test_errors_are_printed_and_programs_do_not_affect_each_other() -> None:
    program, other = (
        start("-c", "import torch; torch.ones = None; torch.ones(3)"),
        start("-c", "import torch; print(torch.ones(3))"),
    )
    assert "TypeError: 'NoneType' object is not callable" in program.communicate(60)[0] and program.returncode == 1
    assert other.communicate(60) == ("tensor([1., 1., 1.])\n", None)


def test_a_bare_program_finds_the_libraries_imported_but_nothing_of_splatrl() -> None:
    asks = "import sys; print('torch' in sys.modules, 'splatrl' in sys.modules, 'matplotlib' in sys.modules)"
    assert start("-c", asks).communicate(60)[0] == "True True True\n"
    assert start("-c", asks, bare=True).communicate(60)[0] == "True False False\n"


def test_a_program_imports_from_pythonpath(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("print('imported')")
    env = os.environ | {"PYTHONPATH": str(tmp_path)}
    assert start("-c", "import mine", env=env).communicate(60)[0] == "imported\n"


def test_the_processes_of_a_run_share_one_interpreter() -> None:
    tells = "import splatrl.runs; print(id(splatrl.runs))"  # its address, which differs from process to process
    asks = f"from tests.preloaded import start; print(*start('-c', {tells!r}).communicate(60), sep='', end='')"
    env = os.environ | {"PYTEST_XDIST_TESTRUNUID": os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid()))}
    here, there = start("-c", tells), start("-c", asks, env=env)
    assert here.communicate(60)[0] + "None" == there.communicate(60)[0]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_program_that_is_sent_a_signal_ends_by_it(number: int) -> None:
    program = start("-c", "import time; print('begun', flush=True); time.sleep(600)")
    assert program.stdout.readline() == "begun\n"
    assert program.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        program.wait(0.01)
    with pytest.raises(subprocess.TimeoutExpired):
        program.communicate(0.01)
    program.send_signal(number)
    assert program.wait(60) == -number
    program.kill()  # it has ended, so this does nothing
    with pytest.raises(ProcessLookupError):
        for _ in range(1000):  # the process that waits for it may be a moment late
            os.kill(program.pid, 0)
            time.sleep(0.01)
