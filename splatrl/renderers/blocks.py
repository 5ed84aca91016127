"""The renderer for CPUs for scenes larger than memory: blocks are loaded when a camera needs them."""

import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from torch import Tensor

from splatrl.cameras import Cameras
from splatrl.renderers.base import RenderOutput, checked_background
from splatrl.renderers.block_needs import KeptBlock, Stack, View, groups, size, spare
from splatrl.renderers.native import Effort, NativeRenderer, checked_cameras, empty_pixels, in_models
from splatrl.renderers.packed import packed_bytes, top_of
from splatrl.renderers.packed_blocks import Packing, for_each_block
from splatrl.renderers.parts import ABSENT, Parts, in_scenes
from splatrl.scenes.blocks import Block, BlockScene
from splatrl.scenes.cache import Arrays, cached_arrays
from splatrl.scenes.gaussians import Gaussians
from splatrl.scenes.scene import Scene
from splatrl.values import require_number

TOP_GROUPS = 512
"""Groups of 16 Gaussians per block that always stay in memory."""


class BlockRenderer(NativeRenderer):
    """A ``NativeRenderer`` that also draws ``BlockScene``, and keeps in memory only the blocks that cameras see.

    Each camera draws its visible blocks as parts of one image, so an image across a border is the same as that of the
    merged scene: with a ``tolerance`` of 0, except for Gaussians of equal depth; with level of detail, as if each block
    were a model. The top of each block's tree, which holds only merged Gaussians, is always in memory and shows distant
    blocks: the whole block is loaded if the tolerance requires more detail than its top has. So which blocks happen to
    be in memory never changes a byte of an image.

    ``budget`` bounds the memory of blocks; the least recently used ones are evicted. If a batch needs more at once, it
    is drawn in groups of rows. If a single camera needs more, the blocks nearest to it are drawn whole, and only the
    tops of the others: a frame depends on its camera and the settings, but not on what was drawn before.

    The first time that a scene is used, its blocks are packed into the user's cache directory: about 110 bytes per
    Gaussian without harmonics.

    Args:
        scene: as for ``NativeRenderer``; or a ``BlockScene``, or several models, some of which are.
        antialiased: as for ``NativeRenderer``.
        background: colour behind the Gaussians, in [0, 1].
        threads: cores that a batch is spread over, at most those that this process may use; None uses all of these.
        tolerance: pixels by which level of detail may displace what is shown; 0 renders every Gaussian.
        budget: bytes that blocks may take in memory.

    Raises:
        ValueError: as for ``NativeRenderer``; for a budget without room for all tops and the largest block; and, when
            drawing with a tolerance of 0, for one that cannot hold all the blocks that a camera sees.
    """

    def __init__(
        self,
        scene: Scene | Gaussians | Sequence[Scene | Gaussians],
        antialiased: bool = True,
        background: Sequence[float] = (0.0, 0.0, 0.0),
        threads: int | None = None,
        tolerance: float = 0.0,
        budget: float = 2e9,
    ) -> None:
        require_number("renderer.budget", budget, 1)
        self._packing = Packing(tolerance > 0.0, checked_background(background), antialiased)
        self._drawing = threading.Lock()  # blocks in memory must not change while drawing
        self._held: OrderedDict[int, int] = OrderedDict()  # slot of a whole block: bytes; least recently used first
        self._whole: dict[int, KeptBlock] = {}  # by slot
        self._models_at: list[int | Stack] = []
        self._slots = self._tops = 0
        super().__init__(scene, antialiased, background, threads, tolerance)
        self._made_of += (budget,)
        largest = max((kept.bytes for kept in self._whole.values()), default=0)
        if budget < self._tops + largest:
            raise ValueError(
                f"renderer.budget: expected at least {self._tops + largest:,} bytes, for the top of each block's tree "
                f"and the whole of the largest block, got {budget:,.0f}"
            )
        self._room = int(budget) - self._tops

    @property
    def bytes_held(self) -> int:
        """Bytes that blocks currently take, at most the budget."""
        return self._tops + sum(self._held.values())

    @property
    def bytes_in_all(self) -> int:
        """Bytes that all blocks together would take."""
        return self._tops + sum(kept.bytes for kept in self._whole.values())

    def _add_all(self, models: Sequence[Scene | Gaussians], tolerance: float) -> None:
        for model in models:
            if isinstance(model, BlockScene):
                self._add_blocks(model)
            else:
                self._add(self._slots, model, tolerance)
                self._models_at.append(self._slots)
                self._slots += 1

    def _add_blocks(self, model: BlockScene) -> None:
        """Add the tops of a scene's blocks to the core."""
        files = [self._top_file(block) for block in model.blocks]
        for number, (top, kept) in enumerate(for_each_block(self._top, model.blocks, files)):
            slot = self._slots + 2 * number
            self._core.put_model(slot, top or None)
            self._core.put_model(slot + 1, None)
            self._tops += packed_bytes(top)
            self._whole[slot + 1] = kept
        every = [self._whole[self._slots + 2 * number + 1] for number in range(len(files))]
        bounds, errors = np.stack([kept.bounds for kept in every]), np.array([kept.error for kept in every], np.float32)
        self._models_at.append(Stack(self._slots, every, bounds, errors, np.array([kept.bytes for kept in every])))
        self._slots += 2 * len(files)

    def _top_file(self, block: Block) -> str:
        return f"top-{TOP_GROUPS}-{self._packing.name(block)}"

    def _top(self, block: Block) -> tuple[Arrays, KeptBlock]:
        """Return the top of a block (no arrays if every Gaussian is drawn) and the data that is kept about it."""

        def build() -> Arrays:
            whole = self._packing.packed(block)
            top, error = top_of(whole, TOP_GROUPS) if self._packing.merge else ({}, float("inf"))
            return top | {"root": whole["bounds"][0], "error": np.array(error), "size": np.array(packed_bytes(whole))}

        top = cached_arrays(self._top_file(block), build)
        kept = KeptBlock(block, top.pop("root"), float(top.pop("error")), int(top.pop("size")))
        return top, kept

    def _rendered(self, cameras: Cameras, parts: Parts | None) -> RenderOutput:
        shape = (len(cameras), cameras.height, cameras.width)
        device = cameras.camera_to_world.device
        out = RenderOutput(*(torch.empty(*shape, *more, device=device) for more in ((3,), (), ())))
        for rows, placed in self._groups(cameras, parts):
            for whole, drawn in zip(out, super()._rendered(cameras[rows], placed), strict=True):
                whole[rows] = drawn
        return out

    def _draw(self, cameras: Cameras, parts: Parts | None, pixels: Tensor, efforts: Tensor | None = None) -> None:
        for rows, placed in self._groups(cameras, parts):
            if len(rows) == len(cameras):
                super()._draw(cameras, placed, pixels, efforts)
                return
            drawn = empty_pixels(cameras[rows])
            taken = None if efforts is None else torch.empty(len(rows), len(Effort._fields))
            super()._draw(cameras[rows], placed, drawn, taken)
            pixels[rows] = drawn
            if efforts is not None and taken is not None:
                efforts[rows] = taken

    def _groups(self, cameras: Cameras, parts: Parts | None) -> Iterator[tuple[Tensor, Parts]]:
        """Yield groups of rows to be drawn together; their blocks stay in memory until the next group is requested.

        Yields:
            The rows, [R] int64, and their parts, which refer to slots of the core. If the group has all rows, they are
            in order.
        """
        if len(cameras) == 0:
            return
        if parts is None:
            parts = in_scenes(torch.zeros(len(cameras), dtype=torch.int64), None, cameras.camera_to_world.cpu())
        placed = self._placed_blocks(cameras, Parts(parts.model.cpu(), parts.model_to_world.cpu()))
        everything = self._whole.keys() & set(placed.model.unique().tolist())
        with self._drawing:
            if size(everything, self._whole) <= self._room:
                self._keep(everything)
                yield torch.arange(len(cameras)), placed
                return
            needed = [self._whole.keys() & set(row) for row in placed.model.tolist()]
            for rows in groups(needed, self._whole, self._room):
                self._keep(set().union(*(needed[row] for row in rows)))
                chosen = torch.tensor(rows, dtype=torch.int64)
                yield chosen, placed.rows(chosen)

    def _keep(self, needed: set[int]) -> None:
        """Load whole blocks, evicting the least recently used others if necessary."""
        for slot in sorted(needed & self._held.keys()):
            self._held.move_to_end(slot)
        for slot in sorted(needed - self._held.keys()):
            kept = self._whole[slot]
            for oldest in [held for held in self._held if held not in needed]:
                if sum(self._held.values()) + kept.bytes <= self._room:
                    break
                self._core.put_model(oldest, None)
                del self._held[oldest]
            self._core.put_model(slot, self._packing.packed(kept.block))
            self._held[slot] = kept.bytes

    def _placed_blocks(self, cameras: Cameras, parts: Parts) -> Parts:
        """Return parts that refer to slots of the core, with each scene in blocks replaced by its visible blocks."""
        own, K = checked_cameras(cameras)
        poses = in_models(own, parts)
        plain = torch.tensor([ABSENT, *(ABSENT if isinstance(at, Stack) else at for at in self._models_at)])
        views: list[View] = []
        for part, model in enumerate(parts.model.unbind(1)):
            for number, stack in enumerate(self._models_at):
                rows = (model == number).nonzero().squeeze(1)
                if isinstance(stack, Stack) and len(rows):
                    own_poses = poses[rows, part].contiguous()
                    needs = np.empty((len(rows), len(stack.kept)), np.uint8)
                    self._core.needs(
                        stack.bounds, stack.errors, own_poses, K[rows], cameras.width, cameras.height, needs
                    )
                    views.append(View(stack, part, rows, own_poses[:, :3, 3].numpy(), needs))
        spare(views, len(cameras), self._room, self._packing.merge)
        columns = []
        for part, model in enumerate(parts.model.unbind(1)):
            columns.append((plain[model + 1].unsqueeze(1), part))
            columns += [(view.slots(len(cameras)), part) for view in views if view.part == part]
        stands = [part for slots, part in columns for _ in range(slots.shape[1])]
        return Parts(torch.cat([slots for slots, _ in columns], 1), parts.model_to_world[:, stands])
