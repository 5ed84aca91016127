"""The server answers only its own page."""

import logging
import socket
from collections.abc import Iterator

import pytest

from splatrl.viewer.server import address, close, is_own_page, open_server
from tests.viewer.visitor import Visitor, viser


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    opened = open_server("127.0.0.1", 0, "room")
    yield opened
    close(opened)


@pytest.mark.parametrize(
    ("origin", "asked", "host", "own"),
    [
        (None, "127.0.0.1:8080", "127.0.0.1", True),
        ("http://127.0.0.1:8080", "127.0.0.1:8080", "127.0.0.1", True),
        ("http://localhost:8080", "localhost:8080", "127.0.0.1", True),
        ("http://[::1]:8080", "[::1]:8080", "::1", True),
        ("http://evil.example", "127.0.0.1:8080", "127.0.0.1", False),
        ("http://127.0.0.1:9000", "127.0.0.1:8080", "127.0.0.1", False),
        ("http://evil.example:8080", "evil.example:8080", "127.0.0.1", False),  # by DNS rebinding
        ("null", "127.0.0.1:8080", "127.0.0.1", False),
        ("http://robot.lan:8080", "robot.lan:8080", "0.0.0.0", True),
        ("http://evil.example", "robot.lan:8080", "0.0.0.0", False),
    ],
)
def test_only_the_servers_own_page_may_connect(origin: str | None, asked: str, host: str, own: bool) -> None:
    assert is_own_page(origin, asked, host) is own


def test_the_page_of_another_site_receives_nothing(server: viser.ViserServer) -> None:
    server.scene.add_label("/secret", "here")
    own = Visitor(address(server), address(server))
    own.find("LabelMessage")
    stranger = Visitor(address(server), "http://evil.example")
    stranger._thread.join(timeout=20.0)
    assert stranger.messages == [] and stranger.socket.close_code == 1008
    own.close()


def test_a_page_that_opens_leaves_nothing_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    server = open_server("127.0.0.1", 0, "room")
    server.scene.add_label("/any", "thing")
    visitor = Visitor(address(server))
    visitor.find("LabelMessage")
    visitor.close()
    close(server)
    assert [one.getMessage() for one in caplog.records if one.name.startswith("websockets")] == []


def test_the_panel_is_docked_beside_the_scene(server: viser.ViserServer) -> None:
    visitor = Visitor(address(server))
    docked = visitor.find("GuiSetPanelPositionMessage")
    assert docked["position"] == {"kind": "edge", "edge": "right"}, "a floating panel hides half of the scene"
    visitor.close()


def test_no_page_can_request_a_public_share_url(server: viser.ViserServer, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []
    monkeypatch.setattr(viser.ViserServer, "request_share_url", lambda self: asked.append(self))
    visitor = Visitor(address(server))
    visitor.send("ShareUrlRequest")
    server.scene.add_label("/after", "it")
    visitor.find("LabelMessage")
    assert asked == []
    visitor.close()


def test_the_server_listens_at_the_given_address_or_on_the_next_free_port(server: viser.ViserServer) -> None:
    assert address(server) == f"http://127.0.0.1:{server.get_port()}"
    other = open_server("127.0.0.1", server.get_port(), "room")  # the port is taken, so the next one is used
    assert other.get_port() > server.get_port()
    close(other)
    with pytest.raises(OSError):
        socket.create_connection(("127.0.0.1", other.get_port()), timeout=1.0)


@pytest.mark.parametrize(
    ("host", "port", "message"),
    [
        ("192.0.2.1", 0, "host: expected an address of this machine, got 192.0.2.1"),
        ("no such host", 0, "host: expected an address of this machine"),
        ("127.0.0.1", 70000, "port: expected a whole number from 0 to 65535, got 70000"),
    ],
)
def test_an_impossible_address_is_refused(host: str, port: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        open_server(host, port, "room")


def test_the_error_for_a_missing_extra_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "viser", None)
    with pytest.raises(ImportError, match=r"pip install 'splatrl\[view\]'"):
        open_server("127.0.0.1", 0, "room")
