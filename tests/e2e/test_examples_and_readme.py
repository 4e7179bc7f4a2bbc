"""What is written is true: code blocks and examples run, commands and links exist, tables are complete."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import kinecast
from kinecast.cli.evaluate import DEFAULT_METHODS
from kinecast.cli.recordings import FORMAT_NAMES
from kinecast.types import Status

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))

LINK = re.compile(r"\[([^\]]*)\]\(([^)\s]+)\)")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page: Path, language: str) -> list[str]:
    """The page's code blocks in one language."""
    return [code for name, code in BLOCK.findall(page.read_text(encoding="utf-8")) if name == language]


def python_blocks() -> list[tuple[str, str]]:
    """Every Python block with the page and its number for a name."""
    return [(f"{page.name}-{k}", code) for page in PAGES for k, code in enumerate(blocks(page, "python"))]


def run(arguments: list[str], folder: Path) -> str:
    """What a Python process prints; warnings are errors."""
    done = subprocess.run(
        [sys.executable, "-W", "error", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(("name", "code"), python_blocks(), ids=[name for name, _ in python_blocks()])
def test_code_blocks_run(name: str, code: str, tmp_path: Path) -> None:
    file = tmp_path / f"{name}.py"
    file.write_text(code, encoding="utf-8")
    run([str(file)], tmp_path)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run_alone_and_leave_nothing_behind(example: Path, tmp_path: Path) -> None:
    assert run([str(example)], tmp_path).strip()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_examples_open_with_a_title_a_sentence_and_what_they_show(example: Path) -> None:
    title, sentence, shows = (ast.get_docstring(ast.parse(example.read_text(encoding="utf-8"))) or "").split("\n\n")
    assert "\n" not in title
    assert title.endswith(".")
    assert sentence.endswith(".")
    assert shows.startswith("Shows: ")
    assert f"examples/{example.name}" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_first_block_is_twelve_lines_on_a_real_person() -> None:
    first = [line for line in blocks(ROOT / "README.md", "python")[0].splitlines() if line.strip()]
    assert len(first) <= 12
    assert any("shipped_clips()" in line for line in first)
    assert "prediction.status" in first[-1]


def test_public_names_are_few_and_each_is_used_on_the_first_pages() -> None:
    assert len(kinecast.__all__) <= 20
    code = "\n".join(code for page in ("README.md", "docs/library.md") for code in blocks(ROOT / page, "python"))
    for name in kinecast.__all__:
        assert hasattr(kinecast, name)
        assert re.search(rf"\b{name}\b", code), name


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    """A link to a file finds it; one whose text is a name in backticks finds that name in the file."""
    for text, target in LINK.findall(page.read_text(encoding="utf-8")):
        if target.startswith(("https://", "#")):
            continue
        file = (page.parent / target.partition("#")[0]).resolve()
        assert file.is_relative_to(ROOT), target
        assert file.exists(), f"{target} does not exist"
        name = re.fullmatch(r"`(\w+)`", text)
        if name and file.suffix == ".py":
            assert name[1] in defined(file), f"{file.name} does not define {name[1]}"


def defined(file: Path) -> set[str]:
    """Names of functions, classes and module constants of a file."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return names


def commands() -> list[list[str]]:
    """Every kinecast command of the pages' shell blocks, as words."""
    text = "\n".join(code for page in PAGES for code in blocks(page, "sh")).replace("\\\n", " ")
    return [line.partition(" #")[0].split() for line in text.splitlines() if line.startswith("kinecast ")]


def test_commands_of_the_pages_have_the_options_it_names(capsys: pytest.CaptureFixture[str]) -> None:
    from kinecast.cli.commands import run

    seen = {}
    for _, command, *words in commands():
        if command not in seen:
            with pytest.raises(SystemExit) as stopped:
                run([command, "--help"])
            assert stopped.value.code == 0
            seen[command] = capsys.readouterr().out
        for option in (word for word in words if word.startswith("--")):
            assert f"{option} " in seen[command], f"kinecast {command} has no {option}"
    assert {"info", "train", "evaluate", "predict", "download", "live", "robot"} <= set(seen)


def test_make_targets_of_the_readme_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    named = re.findall(r"^make (\w+)", "\n".join(blocks(ROOT / "README.md", "sh")), re.MULTILINE)
    assert {"demo", "test"} <= set(named)
    for target in named:
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def test_tables_are_complete() -> None:
    results = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    for method in DEFAULT_METHODS.split(","):
        assert f"| `{method}`" in results, method
    conventions = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
    for status in Status:
        assert f"| {status.name} |" in conventions, status.name
    datasets = (ROOT / "docs" / "datasets.md").read_text(encoding="utf-8")
    for name in FORMAT_NAMES:
        assert f"| `{name}` |" in datasets, name
