"""Texts that the page shows as they are."""

import re

import pytest

from splatrl.viewer.markdown import plain


@pytest.mark.parametrize(
    "text", ["type scene=<folder>", "<img src='http://here/x.png'>", "a_b_c *x* [y](z) `k` \\ & ~~s~~ # 1. | {1+1}"]
)
def test_every_character_with_a_meaning_in_markdown_or_html_is_escaped(text: str) -> None:
    shown = plain(text)
    assert not re.search(r"(?<!\\)[<>*_\[\]`&~#|{}!]", shown.replace("\\\\", ""))
    assert re.sub(r"\\(.)", r"\1", shown) == text


def test_a_text_of_several_lines_takes_one() -> None:
    assert plain("one\n\n    two") == "one two"
