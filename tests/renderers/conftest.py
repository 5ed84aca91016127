"""A cache of levels of detail: many tests here draw the same Gaussians again and again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from torch import Tensor

    from splatrl.scenes.cache import Arrays


@pytest.fixture(scope="session", autouse=True)
def levels_once() -> Iterator[None]:
    """Let renderers of every kind share the levels that were built from equal arrays."""
    from hashlib import sha1

    from splatrl.renderers import lod, packed

    build = lod.build_levels
    known: dict[tuple[int, bytes], Arrays] = {}

    def remembered(arrays: Mapping[str, Tensor], degree: int) -> Arrays:
        digest = sha1(usedforsecurity=False)
        for name, values in sorted(arrays.items()):
            digest.update(name.encode())
            digest.update(values.numpy().tobytes())
        key = degree, digest.digest()
        if key not in known:
            known[key] = build(arrays, degree)
            for built in known[key].values():
                built.flags.writeable = False
        return dict(known[key])

    with pytest.MonkeyPatch.context() as patched:
        for module in (lod, packed):
            patched.setattr(module, "build_levels", remembered)
        yield
