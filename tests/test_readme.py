"""The README tells the truth."""

import re
from pathlib import Path

import pytest

README = (Path(__file__).parents[1] / "README.md").read_text()


def test_the_library_snippet_runs(capsys: pytest.CaptureFixture[str]) -> None:
    snippets = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert snippets
    for snippet in snippets:
        exec(compile(snippet, "README.md", "exec"), {})
    assert "[8, 20, 64, 64, 3]" in capsys.readouterr().out.replace("torch.Size", "")


def test_every_place_it_names_exists() -> None:
    tree = README.split("## Where things are")[1]
    root = Path(__file__).parents[1]
    names = re.findall(r"^(  )?([a-z_]+(?:/[a-z_]+)?(?:\.py|/|\.md))", tree, re.MULTILINE)
    assert len(names) > 10
    for indent, name in names:
        assert (root / ("splatrl" if indent else "") / name).exists(), name
