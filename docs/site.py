"""MkDocs hooks that add README, CONTRIBUTING and CHANGELOG to the site, with adjusted links."""

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
SOURCES = re.compile(r"\[([^\]]*)\]\(\.\./[^)]*\)")
"""Links to files of the repository that are not on the site."""
BADGES = re.compile(r"^\[!\[ci\].*\n", re.MULTILINE)
"""The README's line of badges, which only makes sense on the repository's page."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages to the site."""
    for name, page in PAGES.items():
        text = (ROOT / name).read_text(encoding="utf-8").replace("](docs/", "](")
        for other, its_page in PAGES.items():
            text = text.replace(f"]({other})", f"]({its_page})")
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Remove the badges, and replace links to files that are not on the site by their text."""
    return SOURCES.sub(r"\1", BADGES.sub("", markdown))
