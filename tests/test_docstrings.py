"""Docstrings have the form from which the documentation's site is built, and name the arguments that there are."""

import logging
from pathlib import Path

import griffe
import pytest

import splatrl


def _parse(thing: griffe.Object | griffe.Alias) -> None:
    """Parse the docstrings of a thing and of all that it defines; griffe logs what it cannot parse."""
    if isinstance(thing, griffe.Alias):
        return
    if thing.docstring:
        _ = thing.docstring.parsed
    for member in thing.members.values():
        _parse(member)


def test_docstrings_can_be_parsed(caplog: pytest.LogCaptureFixture):
    package = Path(splatrl.__file__).parent
    with caplog.at_level(logging.WARNING, "griffe"):
        _parse(griffe.load("splatrl", search_paths=[package.parent], docstring_parser="google", allow_inspection=False))
    assert not [record.getMessage() for record in caplog.records]
