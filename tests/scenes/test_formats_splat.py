from pathlib import Path

import pytest
import torch

from splatrl.scenes.formats import read_gaussians
from splatrl.spherical_harmonics import C0
from tests.scenes.samples import splat_bytes


def test_bytes_are_decoded_as_the_format_says(tmp_path: Path) -> None:
    content = splat_bytes(
        means=[(1.5, -2.0, 3.25), (0.0, 0.0, -7.0)],
        scales=[(0.1, 0.2, 0.3), (1.0, 2.0, 4.0)],
        rgba=[(255, 0, 51, 255), (102, 153, 204, 51)],
        quats=[(255, 128, 128, 128), (128, 208, 128, 68)],
    )
    (tmp_path / "a.splat").write_bytes(content)
    gaussians = read_gaussians(tmp_path / "a.splat")
    assert gaussians.means.tolist() == [[1.5, -2.0, 3.25], [0.0, 0.0, -7.0]]
    torch.testing.assert_close(gaussians.scales, torch.tensor([[0.1, 0.2, 0.3], [1.0, 2.0, 4.0]]))
    torch.testing.assert_close(gaussians.opacities, torch.tensor([1.0, 0.2]))
    assert gaussians.sh.shape == (2, 1, 3)
    torch.testing.assert_close(0.5 + C0 * gaussians.sh[:, 0], torch.tensor([[1.0, 0.0, 0.2], [0.4, 0.6, 0.8]]))
    torch.testing.assert_close(gaussians.quats, torch.tensor([[1.0, 0, 0, 0], [0, 0.8, 0, -0.6]]))


def test_a_file_that_ends_within_a_record_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.splat").write_bytes(bytes(63))
    with pytest.raises(ValueError, match=r"a\.splat: expected a multiple of 32 bytes, got 63"):
        read_gaussians(tmp_path / "a.splat")


def test_records_of_zeros_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.splat").write_bytes(bytes(64))
    with pytest.raises(ValueError, match=r"a\.splat: expected at least one finite, visible Gaussian, got none among 2"):
        read_gaussians(tmp_path / "a.splat")
