"""The page's web server: viser's, by default on loopback, which accepts connections only from its own page."""

import io
import logging
import socket
from contextlib import redirect_stdout
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from splatrl.extras import require
from splatrl.values import require_number

if TYPE_CHECKING:
    import viser

LOOPBACK = ("127.0.0.1", "localhost", "::1")
POLICY_VIOLATION = 1008
"""Status code for closing a websocket because of a policy violation (RFC 6455, section 7.4.1)."""
PATIENCE = 5.0
"""Maximum seconds to wait for a stopping server."""


def open_server(host: str, port: int, label: str) -> "viser.ViserServer":
    """Start serving an empty page.

    Args:
        host: address of this machine to listen on; those in ``LOOPBACK`` can be reached from this machine only.
        port: port to listen on; if it is taken, the next free one is used; 0 uses any.
        label: title of the page's panel.

    Raises:
        ImportError: without the extra ``view``.
        ValueError: for a host that is not an address of this machine, or a port out of range.
    """
    viser = require("viser", "view", "the page needs viser")
    require_number("port", port, 0, 65535, whole=True)
    _check_host(host)
    logging.getLogger("websockets").setLevel(logging.WARNING)  # it reports every page that opens
    with redirect_stdout(io.StringIO()):  # viser draws its address in a box
        server = viser.ViserServer(host, port, label=label, verbose=False)
    server.gui.configure_theme(show_share_button=False, show_logo=False, control_width="large")
    server.gui.main_panel.dock_right()  # beside the scene, whose right half a floating panel would hide
    _keep_to_itself(server, host)
    return server


def address(server: "viser.ViserServer") -> str:
    """Return the page's URL."""
    host = server.get_host()
    shown = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(host, host)
    return f"http://{f'[{shown}]' if ':' in shown else shown}:{server.get_port()}"


def close(server: "viser.ViserServer") -> None:
    """Stop serving, without printing anything."""
    with redirect_stdout(io.StringIO()):
        server.stop()
        thread = server._websock_server._server_thread
        if thread is not None:
            thread.join(timeout=PATIENCE)  # it prints just before it ends


def is_own_page(origin: str | None, host_header: str | None, host: str) -> bool:
    """Whether a websocket comes from a page of this server, or from a client that is not a browser.

    Any site open in the same browser can connect to a server on loopback, and its own host name may resolve to it too
    (DNS rebinding).

    Args:
        origin: the request's Origin header, set by browsers; None for other clients.
        host_header: the request's Host header.
        host: address on which the server listens.
    """
    if origin is None:
        return True
    asking = urlsplit(origin)
    return asking.netloc == host_header and (host not in LOOPBACK or asking.hostname in LOOPBACK)


def _check_host(host: str) -> None:
    try:
        family, kind, *_, place = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as tried:
            tried.bind(place)
    except OSError as error:
        raise ValueError(f"host: expected an address of this machine, got {host}") from error


def _keep_to_itself(server: "viser.ViserServer", host: str) -> None:
    """Close connections from pages of other sites, and disable viser's sharing of the page through a tunnel.

    viser has no setting for either, so this uses its internals; ``pyproject.toml`` restricts its versions.
    """
    from viser import _messages

    own = server._websock_server
    own.unregister_handler(_messages.ShareUrlRequest)

    async def check(connection: Any) -> None:
        socket_ = own._live_connections[connection.client_id]
        headers = socket_.request.headers if socket_.request is not None else {}
        if not is_own_page(headers.get("Origin"), headers.get("Host"), host):
            await socket_.close(POLICY_VIOLATION, "the page of another site")

    own.on_client_connect(check)
