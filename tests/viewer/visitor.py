"""A browser without a picture: it opens the page's websocket, notes what is sent, and answers as a person would."""

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
"""Seconds until something that is waited for is missing."""


def until(holds: Callable[[], Any], what: str, patience: float = PATIENCE) -> Any:
    """What is given, once it is true."""
    end = time.monotonic() + patience
    while not (found := holds()):
        assert time.monotonic() < end, f"never came: {what}"
        time.sleep(0.01)
    return found


class Visitor:
    """A client of a page.

    Args:
        address: of the page.
        origin: of the asking page; None is no browser.
    """

    def __init__(self, address: str, origin: str | None = None):
        self.socket: ClientConnection = connect(
            address.replace("http", "ws"), subprotocols=[f"viser-v{viser.__version__}"], origin=origin, max_size=None
        )
        self.messages: list[dict[str, Any]] = []
        self.bytes = 0
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        with suppress(ConnectionClosed):  # it may be shown the door
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
        """A message of a kind, as soon as it has come."""
        return until(lambda: next((m for m in list(self.messages) if m["type"] == kind and fits(m)), None), kind)

    def field(self, label: str) -> str:
        """The identifier of a button, a box or a field by its label."""
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
        """Answer with a picture."""
        with io.BytesIO() as file:
            Image.new("RGB", (message["width"], message["height"])).save(file, "JPEG")
            self.send("GetRenderResponseMessage", payload=file.getvalue(), render_uuid=message["render_uuid"])

    def close(self) -> None:
        """Leave."""
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
