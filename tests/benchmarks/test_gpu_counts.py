"""benchmarks/gpu_counts.py counts the work of a frame on a GPU, without a GPU."""

from typing import Any

import pytest

from splatrl.scenes import Scene
from tests.emulator import PASSES
from tests.tiny import tiny_gaussians


def test_every_loop_is_counted_and_summed_up(benchmark: Any) -> None:
    module, scenes = benchmark("gpu_counts"), benchmark("scenes")
    assert tuple(module.INSTRUCTIONS) == PASSES
    scene = Scene("tiny", tiny_gaussians(), ((-1.5, -2.0, 0.0), (1.5, 2.0, 1.2)))
    subject = scenes.Subject(scene, scenes.Room((-1.0, -1.5, 0.4), (1.0, 1.5, 0.6)))
    two, again = (module.counts(subject, 0.5, views) for views in (2, 2))
    assert two == again
    *loops, sums = two
    assert sums.instructions == sum(line.instructions for line in loops) > 0
    assert all(0 < line.busy <= 1 for line in loops if line.passes)
    found = {line.loop: line for line in loops}
    assert found["project"].passes <= found["test"].passes * 32
    assert found["color"].bytes == pytest.approx(32 * found["color"].busy * found["color"].passes * (16 + 6))
