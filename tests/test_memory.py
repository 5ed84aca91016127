"""Files that claim as much as they may: reading each takes no more memory than its kind is allowed."""

import sys
from dataclasses import astuple

import pytest

from tests.builds import measured_once
from tests.memory import COSTLY, Cost, measured

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
SLOW = ("photo", "transparent photo", "depth", "sprite", "large video", "spz")
"""Kinds that take most of a gigabyte or more, whatever the size of the file, or seconds, and resemble another kind."""
NEEDS = {name: "gsply" for name in ("sog", "sog, deflate bomb", "sog, bzip2 bomb", "compressed ply")}
NEEDS |= {"lzfse": "imagecodecs"}
REFUSED = {"ascii ply, one line", "json, more lists", "episodes", "checkpoint", "arrays that lie"}
REFUSED |= {f"{kind}, {how} bomb" for kind in ("sog", "r3d") for how in ("deflate", "bzip2")}


def checked(kind: str, cost: Cost) -> None:
    if kind in NEEDS:
        pytest.importorskip(NEEDS[kind], reason=f"needs {NEEDS[kind]}")
    assert cost.memory <= COSTLY[kind].most(cost.size), cost
    assert cost.outcome.startswith("refused" if kind in REFUSED else "read"), cost


@pytest.fixture(scope="module")
def costs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Cost]:
    def measure() -> dict[str, tuple[int, int, str]]:
        return {kind: astuple(cost) for kind, cost in measured([k for k in COSTLY if k not in SLOW]).items()}

    return {kind: Cost(*cost) for kind, cost in measured_once(tmp_path_factory, "memory", measure).items()}


@pytest.mark.parametrize("kind", [kind for kind in COSTLY if kind not in SLOW])
def test_a_file_takes_no_more_memory_than_its_kind_is_allowed(kind: str, costs: dict[str, Cost]) -> None:
    checked(kind, costs[kind])


@pytest.mark.slow
@pytest.mark.parametrize("kind", SLOW)
def test_a_large_file_takes_no_more_memory_than_its_kind_is_allowed(kind: str) -> None:
    checked(kind, measured([kind])[kind])
