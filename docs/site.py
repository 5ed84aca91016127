"""Pages of the site that stand elsewhere in the repository: README, CONTRIBUTING and CHANGELOG, their links moved."""

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
SOURCES = re.compile(r"\[([^\]]*)\]\(\.\./[^)]*\)")
"""Links to files of the repository that the site does not have."""
BADGES = re.compile(r"^\[!\[ci\].*\n", re.MULTILINE)
"""A line of the README that only means something beside the repository."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages."""
    for name, page in PAGES.items():
        text = (ROOT / name).read_text(encoding="utf-8").replace("](docs/", "](")
        for other, its_page in PAGES.items():
            text = text.replace(f"]({other})", f"]({its_page})")
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Name what stands in the repository without a link."""
    return SOURCES.sub(r"\1", BADGES.sub("", markdown))
