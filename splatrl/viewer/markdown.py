"""Text in the Markdown that the page's panel renders."""

import re

PUNCTUATION = re.compile(r"[!-/:-@\[-`{-~]")
"""The characters that a backslash makes literal in Markdown: all of ASCII's punctuation (CommonMark, section 2.4)."""


def plain(text: object) -> str:
    """Escape a text, such as that of an error, so that Markdown shows it as it is, on one line.

    The page would otherwise take ``<folder>`` for an HTML element, and leave it out.
    """
    return PUNCTUATION.sub(r"\\\g<0>", " ".join(str(text).split()))
