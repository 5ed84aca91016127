"""A generated town as a scene, generated once, block by block, and kept in the user's cache directory."""

import functools
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from splatrl.documents import read_json, write_json
from splatrl.files import cache_dir, checked_name, digest_of
from splatrl.native.threads import usable_cores
from splatrl.scenes.blocks import BLOCKS_FILE, BlockScene, read_blocks, write_blocks
from splatrl.scenes.cache import make_room, mark_used, size_of
from splatrl.scenes.formats import write_gaussians
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Bounds, checked_bounds
from splatrl.scenes.town.build import around_gaussians, block_gaussians
from splatrl.scenes.town.plan import SIZE
from splatrl.values import require_number
from splatrl.waits import Bar

DIGESTS = "digests.json"
"""The digests of a town's files, the last file that is written."""
MOST = 31
"""Maximum number of blocks along each side of a town."""
HEIGHT = 9.0
"""Height of a block's bounds, metres."""
MIDDLE: Bounds = ((-10.0, -10.0, 0.0), (10.0, 10.0, 3.0))
"""Default bounds of the region for robots, world frame, metres."""


def town(seed: int = 0, blocks: int = 10, bounds: Sequence[Sequence[float]] | None = None) -> BlockScene:
    """Generate a town: streets around square blocks of 20 m, each with two houses, a yard and trees of its own.

    A block has about 100,000 Gaussians, takes seconds to generate and needs 1 MB of disk space; the whole town is kept
    in the user's cache directory, where damaged files are made again. The same arguments give the same bytes. Two
    streets cross at the origin, where four blocks meet and a red egg stands; on the command line, ``scene=town`` sets
    it as the goal.

    Args:
        seed: seed of the town, at least 0.
        blocks: number of blocks along each side of the town, 1 to 31.
        bounds: lower and upper corner of the region for robots, world frame, metres; None takes the 20 × 20 m around
            the crossing.

    Raises:
        OSError: if the cache cannot be written.
        ValueError: for a seed or a number of blocks out of range, or empty bounds.
    """
    require_number("scene.seed", seed, 0, 2**63 - 1, whole=True)
    require_number("scene.blocks", blocks, 1, MOST, whole=True)
    corners = MIDDLE if bounds is None else checked_bounds(bounds)
    folder = cache_dir() / f"town-{seed}-{blocks}-{_source_digest()}"
    try:
        _remove_damaged(folder)
        if not (folder / DIGESTS).is_file():
            _make(folder, seed, blocks)
            make_room(folder.parent, size_of(folder))
        mark_used(folder)
    except OSError as error:
        told = f"cannot write the town here: {error.strerror or error}; set SPLATRL_CACHE to another folder"
        raise OSError(f"{folder.parent}: {told}") from error
    return read_blocks(folder, corners)


def _remove_damaged(folder: Path) -> None:
    """Remove the files of a town that are not as they were written, with a warning, so that they are made again."""
    if not (folder / DIGESTS).is_file():
        return
    written = {}
    with suppress(AttributeError, ValueError):
        written = {folder / checked_name(DIGESTS, name): digest for name, digest in read_json(folder / DIGESTS).items()}
    damaged = [path for path in written if not path.is_file() or digest_of([path]) != written[path]]
    if folder / BLOCKS_FILE not in written:  # then nothing vouches for any file
        damaged = list(folder.iterdir())
    if not damaged:
        return
    names = ", ".join(path.name for path in damaged[:3]) + (", ..." if len(damaged) > 3 else "")
    warnings.warn(
        f"{folder}: expected the generated town as it was written, got {names} damaged or missing; making them again",
        stacklevel=3,
    )
    for path in (*damaged, folder / DIGESTS):
        path.unlink(missing_ok=True)


def _make(folder: Path, seed: int, blocks: int) -> None:
    """Write a town; blocks that an interrupted run has already written are kept."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers = range(-(blocks // 2), blocks - blocks // 2)
    places = [(column, row) for column in numbers for row in numbers]

    def make(place: tuple[int, int]) -> None:
        _write(folder / _name(*place), lambda: block_gaussians(seed, *place))

    _write(folder / "around.spz", lambda: around_gaussians(seed, numbers, numbers))
    with ThreadPoolExecutor(usable_cores()) as pool:
        for _ in Bar(pool.map(make, places), "town", len(places), unit="block"):
            pass
    low, high = SIZE * numbers[0], SIZE * (numbers[-1] + 1)
    bounds: dict[str, Bounds] = {
        _name(column, row): (
            (SIZE * column, SIZE * row, 0.0),
            (SIZE * (column + 1), SIZE * (row + 1), HEIGHT),
        )
        for column, row in places
    }
    bounds["around.spz"] = ((low, low, 0.0), (high, high, HEIGHT))
    write_blocks(folder, f"town-{seed}", bounds)
    write_json(folder / DIGESTS, {name: digest_of([folder / name]) for name in (*bounds, BLOCKS_FILE)})


def _write(path: Path, make: Callable[[], Gaussians]) -> None:
    if not path.is_file():
        write_gaussians(path, make())


def _name(column: int, row: int) -> str:
    return f"block{column:+d}{row:+d}.spz"


@functools.cache
def _source_digest() -> str:
    """Return a fingerprint of the generator's source, so that no other version ever uses its cached towns."""
    folders = Path(__file__).parent, *(Path(__file__).parents[1] / room for room in ("yard", "yards"))
    return digest_of(path for folder in folders for path in sorted(folder.glob("*.py")))
