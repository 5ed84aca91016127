"""Python programs that start at once, each forked from a process that has already done the slow imports.

A program has its own memory, environment, output, signals and interpreter shutdown, as if ``python -m`` or
``python -c`` had started it. Only the imports are shared: they are done once for all programs of a pytest run.
"""

from __future__ import annotations

import functools
import gc
import importlib
import io
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import threading
import types
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Union

from tests.yaml_once import compose_once, parse_once

ROOT = Path(__file__).parents[1]
LIBRARIES = (
    "scipy.spatial",
    "torchrl.collectors",
    "torchrl.data",
    "torchrl.envs",
    "torchrl.modules",
    "torchrl.objectives",
)
"""Modules already imported in every program, including a bare one, which imports splatrl itself."""
IMPORTED = (
    "matplotlib.figure",
    "splatrl.building",
    "splatrl.datasets",
    "splatrl.experiments",
    "splatrl.runs",
    "splatrl.viewer.page",
    "splatrl.viewer.training",
)
"""Modules also imported in other programs; not the commands, which programs run as their main module."""
MOST_BYTES = 2**17
"""Maximum size of a request: words and environment."""


def start(*words: str, env: Mapping[str, str] | None = None, bare: bool = False) -> Process:
    """Start a program.

    Args:
        words: the words after ``python``: ``-m``, the name of a module and its arguments, or ``-c`` and code.
        env: environment of the program; by default that of this process.
        bare: whether only libraries are already imported, and nothing of splatrl.
    """
    if sys.platform != "linux":  # forking is not safe elsewhere
        command = [sys.executable, *words]
        return subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    env = dict(os.environ if env is None else env)
    request = json.dumps({"words": words, "env": env, "folder": os.getcwd(), "bare": bare})
    link, theirs = socket.socketpair()
    output, printed = os.pipe()
    with theirs:
        socket.send_fds(_interpreter(), [request.encode()], [theirs.fileno(), printed])
    os.close(printed)
    return Program(link, output)


class Program:
    """A running program, with the interface of ``subprocess.Popen``.

    Attributes:
        pid: process ID.
        stdout: what the program prints, errors included.
        returncode: exit status, or minus the signal that ended it; None until ``poll`` or ``wait`` finds it ended.
    """

    def __init__(self, link: socket.socket, output: int) -> None:
        self.stdout = open(output, encoding="utf-8")  # noqa: SIM115
        self.returncode: int | None = None
        self._link = link
        self.pid = int(link.recv(16))

    def poll(self) -> int | None:
        """Return the return code if the program has ended, otherwise None."""
        with suppress(subprocess.TimeoutExpired):
            self.wait(0.0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the program to end, for at most ``timeout`` seconds, and return its return code.

        Raises:
            subprocess.TimeoutExpired: if the program is still running then.
        """
        if self.returncode is None:
            self._link.settimeout(timeout)
            try:
                self.returncode = int(self._link.recv(16))
            except (TimeoutError, BlockingIOError):
                raise subprocess.TimeoutExpired(f"program {self.pid}", timeout or 0.0) from None
        return self.returncode

    def communicate(self, timeout: float | None = None) -> tuple[str, None]:
        """Wait for the program to end, like ``wait``, and return the output that has not been read yet."""
        printed: list[str] = []
        reader = threading.Thread(target=lambda: printed.append(self.stdout.read()), daemon=True)
        reader.start()
        reader.join(timeout)
        if reader.is_alive():
            raise subprocess.TimeoutExpired(f"program {self.pid}", timeout or 0.0)
        self.wait(timeout)
        return printed[0], None

    def send_signal(self, number: int) -> None:
        """Send a signal, unless the program has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask the program to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Kill the program."""
        self.send_signal(signal.SIGKILL)


Process = Union[Program, "subprocess.Popen[str]"]


@functools.cache
def _interpreter() -> socket.socket:
    """Return a connection to the process that forks programs, which ends with the last test process that uses it."""
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID", os.getpid())
    here, address = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET), f"\0splatrl-tests-{run}"
    while here.connect_ex(address):
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as there, suppress(OSError):
            there.bind(address)  # fails if another test process binds the address first
            there.listen()
            command = [sys.executable, "-m", __name__, str(there.fileno())]
            nothing = subprocess.DEVNULL
            subprocess.Popen(command, cwd=ROOT, pass_fds=[there.fileno()], stdin=nothing, stdout=nothing)
    return here


def _requested(
    asking: list[socket.socket], listener: socket.socket | None = None, bare: socket.socket | None = None
) -> list[str]:
    """Fork a process for each request, and return the request's words there; here, return none after the last one.

    Args:
        asking: connections over which requests come.
        listener: socket on which further test processes connect.
        bare: connection to the process that has only the libraries imported.
    """
    gc.freeze()  # or each program would spend a second at exit searching all imports for garbage
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody reaps the processes that wait for programs
    others = [each for each in (listener, bare) if each is not None]
    while asking:
        for ready in select.select([*others[:1], *asking], [], [])[0]:
            if ready is listener:
                asking.append(listener.accept()[0])
                continue
            message, descriptors, *_ = socket.recv_fds(ready, MOST_BYTES, 2)
            if not message:
                asking.remove(ready)
            elif bare is not None and json.loads(message)["bare"]:
                socket.send_fds(bare, [message], descriptors)
            elif os.fork() == 0:
                for each in (*others, *asking):
                    each.close()
                return _begun(json.loads(message), *descriptors)
            for each in descriptors:
                os.close(each)
    return []


def _begun(request: Mapping[str, Any], link_number: int, printed: int) -> list[str]:
    """Fork the program: report its end from this process, and return its words in the one that is to run it."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    link = socket.socket(fileno=link_number)
    child = os.fork()
    if child:
        os.close(printed)
        link.send(b"%16d" % child)
        link.send(b"%16d" % os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
        os._exit(0)
    link.close()
    for standard in (1, 2):
        os.dup2(printed, standard)
    os.close(printed)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["env"])
    sys.path[1:1] = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
    return request["words"]


def _prepare() -> None:
    """Do once what most programs would otherwise do again, from finding Hydra's plugins to loading the fonts."""
    load_config = importlib.import_module("splatrl.configuration").load_config
    importlib.import_module("splatrl.configuration.checking").check_config(load_config())  # reads all of conf/
    load_config(["task=grid", "scene=file", "scene.path=room.ply"])
    figure = importlib.import_module("matplotlib.figure").Figure()
    figure.subplots().set_title("title")
    figure.savefig(io.BytesIO())


def _run(kind: str, what: str, *arguments: str) -> None:
    """Run a module or code as the main module."""
    if kind == "-m":
        sys.argv = [what, *arguments]
        runpy.run_module(what, run_name="__main__", alter_sys=True)
        return
    main = sys.modules["__main__"] = types.ModuleType("__main__")
    sys.argv = [kind, *arguments]
    exec(compile(what, "<string>", "exec"), main.__dict__)


if __name__ == "__main__":
    for name in LIBRARIES:
        importlib.import_module(name)
    parse_once()
    os.fsync = lambda _: None  # as in the tests themselves
    listener, (bare, asking) = socket.socket(fileno=int(sys.argv[1])), socket.socketpair(type=socket.SOCK_SEQPACKET)
    if os.fork() == 0:
        listener.close()
        bare.close()
        words = _requested([asking])
    else:
        asking.close()
        for name in IMPORTED:
            importlib.import_module(name)
        compose_once()
        _prepare()
        words = _requested([listener.accept()[0]], listener, bare)
    if words:
        _run(*words)
