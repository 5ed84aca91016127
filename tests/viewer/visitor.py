"""A client in place of a browser: it opens the page's websocket, records messages, and answers as a person would."""

import io
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest

viser = pytest.importorskip("viser", reason="needs the extra view")

import msgspec  # noqa: E402 - these come with viser
import zstandard  # noqa: E402
from PIL import Image  # noqa: E402
from websockets.exceptions import ConnectionClosed  # noqa: E402
from websockets.sync.client import ClientConnection, connect  # noqa: E402

PATIENCE = 20.0
"""Seconds to wait for something before it counts as missing."""


def until(holds: Callable[[], Any], what: str, patience: float = PATIENCE) -> Any:
    """Wait for a result that is true, and return it."""
    end = time.monotonic() + patience
    while not (found := holds()):
        assert time.monotonic() < end, f"never came: {what}"
        time.sleep(0.01)
    return found


class Visitor:
    """A client of a page.

    Args:
        address: the page's address.
        origin: origin of the page that connects; None for a client that is no browser.
    """

    def __init__(self, address: str, origin: str | None = None):
        self.socket: ClientConnection = connect(
            address.replace("http", "ws"), subprotocols=[f"viser-v{viser.__version__}"], origin=origin, max_size=None
        )
        self.messages: list[dict[str, Any]] = []
        self.bytes = 0
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        with suppress(ConnectionClosed):  # the server may refuse it
            self._look()

    def _look(self) -> None:
        self.send(
            "ViewerCameraMessage",
            wxyz=(1.0, 0.0, 0.0, 0.0),
            position=(0.0, 0.0, 1.0),
            fov=1.0,
            near=0.1,
            far=100.0,
            image_height=300,
            image_width=400,
            look_at=(0.0, 1.0, 0.0),
            up_direction=(0.0, 0.0, 1.0),
        )

    def send(self, kind: str, **fields: Any) -> None:
        """Send a message."""
        self.socket.send(msgspec.msgpack.encode({"type": kind, **fields}))

    def find(self, kind: str, fits: Callable[[dict[str, Any]], bool] = lambda message: True) -> dict[str, Any]:
        """Wait for a message of a kind that fits, and return it."""
        return until(lambda: next((m for m in list(self.messages) if m["type"] == kind and fits(m)), None), kind)

    def field(self, label: str) -> str:
        """Return the identifier of the button, box or field with a label."""
        found = until(lambda: [m for m in list(self.messages) if m.get("props", {}).get("label") == label], label)
        return found[0]["uuid"]

    def click(self, label: str, value: Any = True) -> None:
        """Press a button, or set a box or a field."""
        self.send("GuiUpdateMessage", uuid=self.field(label), updates={"value": value})

    def press(self, name: str) -> None:
        """Press the key of a command."""
        self.send("CommandTriggerMessage", uuid=self.field(f"robot: {name}"))

    def drag(self, handle: str, position: tuple[float, ...], wxyz: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)) -> None:
        """Drag a handle."""
        self.send("TransformControlsDragStartMessage", name=handle)
        self.send("TransformControlsUpdateMessage", name=handle, wxyz=wxyz, position=position)
        self.send("TransformControlsDragEndMessage", name=handle)

    def _draw(self, message: dict[str, Any]) -> None:
        """Answer a request for a render with a black image."""
        with io.BytesIO() as file:
            Image.new("RGB", (message["width"], message["height"])).save(file, "JPEG")
            self.send("GetRenderResponseMessage", payload=file.getvalue(), render_uuid=message["render_uuid"])

    def close(self) -> None:
        """Disconnect."""
        self.socket.close()
        self._thread.join(timeout=5.0)

    def _read(self) -> None:
        try:
            while True:
                frame = self.socket.recv()
                assert isinstance(frame, bytes)
                self.bytes += len(frame)
                packed = frame[16 : 16 + int.from_bytes(frame[8:16], "little")]
                inner = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(packed))
                self.messages.extend(inner["messages"])
                for message in inner["messages"]:
                    if message["type"] == "GetRenderRequestMessage":
                        self._draw(message)
        except ConnectionClosed:
            pass
