"""README and documentation are true: snippets run, commands are valid, and paths and links exist."""

import re
import shlex
import sys
from collections import Counter
from pathlib import Path
from pydoc import locate

import pytest

import splatrl
from splatrl.commands.entries import PARSERS
from splatrl.configuration import command_line, load_config, save_config

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
DOCS = sorted((ROOT / "docs").glob("*.md"))
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
FENCED = BLOCK.findall(README)
COMMANDS = {
    " ".join(words): words
    for text in (README, *(path.read_text() for path in DOCS if path.name != "extending.md"))  # needs a plugin
    for language, block in BLOCK.findall(text)
    if not language
    for line in block.replace("\\\n", " ").splitlines()
    for part in line.split(" && ")
    if part.startswith("splatrl-") and (words := shlex.split(part, comments=True))
}
HOSTED = ("http", "../../actions/")  # pages of other sites, and of the one that hosts the README
NEEDS_A_PLUGIN = "+launcher="  # launchers are Hydra plugins, from the extra cluster


def test_the_library_snippet_runs(capsys: pytest.CaptureFixture[str]) -> None:
    snippets = [block for language, block in FENCED if language == "python"]
    assert snippets
    for snippet in snippets:
        exec(compile(snippet, "README.md", "exec"), {})
    assert "[8, 20, 64, 64, 3]" in capsys.readouterr().out.replace("torch.Size", "")


@pytest.mark.parametrize("page", ["physics.md", "scenes.md"])
def test_the_snippets_of_a_page_run(page: str) -> None:  # tests/envs/test_workers.py runs those of clients.md
    snippets = [block for language, block in BLOCK.findall((ROOT / "docs" / page).read_text()) if language == "python"]
    assert snippets
    for snippet in snippets:
        exec(compile(snippet, page, "exec"), {})


def test_the_readme_lists_every_package_and_every_page() -> None:
    listed = README.split("## Where things are")[1]
    packages = {path.parent.name for path in (ROOT / "splatrl").glob("*/__init__.py")}
    assert set(re.findall(r"^\| `splatrl/(\w+)/`", listed, re.MULTILINE)) == packages
    for name in re.findall(r"`(\w+)/`", listed):
        assert (ROOT / name).is_dir(), name
    assert set(re.findall(r"\]\(docs/(\w+\.md)\)", listed)) == {path.name for path in (ROOT / "docs").glob("*.md")}


def test_the_readme_shows_every_command() -> None:
    scripts = re.findall(r"^(splatrl-\w+) = ", (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    assert scripts and all(script in README for script in scripts)


def test_no_change_stands_twice_in_the_changelog() -> None:  # as after a merge of what was moved meanwhile
    changes = [line for line in (ROOT / "CHANGELOG.md").read_text().splitlines() if line.startswith("- ")]
    assert [line for line, times in Counter(changes).items() if times > 1] == []


@pytest.mark.parametrize("page", [*DOCS, *sorted(ROOT.glob("*.md"))], ids=lambda path: path.name)
def test_links_between_pages_lead_to_existing_files_and_headings(page: Path) -> None:
    for link, heading in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", page.read_text()):
        if link.startswith(HOSTED):
            continue
        path = page.parent / link if link else page
        assert path.exists(), link
        assert not heading or heading in _anchors(path), f"{link}#{heading}"


def _anchors(page: Path) -> list[str]:
    """Return the anchors of a page's headings, as hosts of repositories make them."""
    headings = re.findall(r"^#+ (.*)$", BLOCK.sub("", page.read_text()), re.MULTILINE)
    return [re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings]


def test_the_page_of_the_api_documents_every_public_name() -> None:
    shown = [locate(name) for name in re.findall(r"^::: (\S+)$", (ROOT / "docs" / "api.md").read_text(), re.MULTILINE)]
    for name in splatrl.__all__:
        thing = getattr(splatrl, name)
        assert thing in shown or sys.modules[thing.__module__] in shown, name


@pytest.mark.usefixtures("unmade_yards")
@pytest.mark.parametrize(
    "words", [words for line, words in COMMANDS.items() if NEEDS_A_PLUGIN not in line], ids=" ".join
)
def test_a_command_in_the_readme_or_documentation_is_valid(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Check that keys and chosen options exist, without running anything."""
    monkeypatch.chdir(tmp_path)
    for name in ("garden.ply", "kitchen.spz", "my_robot.xml", "my_box.xml", "episodes.json.gz"):
        (tmp_path / name).touch()
    for name in ("garden", "mine", "kitchen", "redkitchen"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "scene.yaml").write_text("splat: splat.ply\n")
    (tmp_path / "city").mkdir()
    (tmp_path / "city" / "blocks.yaml").write_text("blocks: [{splat: a.ply}]\n")
    run = tmp_path / "outputs" / "2026-01-31" / "12-00-00"
    run.mkdir(parents=True)
    save_config(load_config(), run)
    name, arguments = words[0].removeprefix("splatrl-"), [word for word in words[1:] if word not in ("-m", "--help")]
    if name in PARSERS:
        PARSERS[name](arguments)
        return
    if "-m" in words:  # the first job of a sweep
        arguments = [word.split(",")[0] for word in arguments]
    load_config(command_line(name, arguments), name)
