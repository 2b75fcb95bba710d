"""Build the site: `python tools/build_docs.py [FOLDER]` lays pages out in build/docs and has Zensical write site/.

Pages lie there as in the repository, so that links hold in both places. The command line's page is made of the
commands' own help (its list of commands lies in the repository, too, and is written anew), the one of mistakes by
making them, the one of `--json` of docs/schemas.json, the notebook's of the notebook, the picture of the rooms of the
directions that a test holds. A click opens a picture in full size; a page of wide tables has no list of headings
beside it.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

from draw_rooms import rooms_svg
from mistakes import mistakes_page

ROOT = Path(__file__).resolve().parents[1]
TAKEN = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "docs", "examples", "records", "LICENSES")
WIDTH = "80"
"""Columns of the commands' help: what a page shows without scrolling on a desk."""
CODE = re.compile(r"(^```.*?^```$|^    [^\n]*$|`[^`\n]*`)", re.MULTILINE | re.DOTALL)
UNIT = re.compile(r"(\d) (%|GB|MB|ms|px|dpi|cm)(?!\w)")
PICTURE = re.compile(r"^!\[[^\]]*\]\(([^)\s]+)\)$", re.MULTILINE)
WIDE_TABLE = re.compile(r"^(?:\|[^|\n]*){9,}\|$", re.MULTILINE)
"""A row of nine columns or more."""
SHIM = "https://unpkg.com/iframe-worker/shim"
"""What the theme would fetch from elsewhere, so that the search works from the disk; ours does it instead."""


COMMANDS_LIST = ROOT / "docs" / "reference" / "commands.md"


def main() -> int:
    """Write the list of commands, lay out and build.

    The exit code is Zensical's, which is strict: a dead link or an unknown name fails.
    """
    base = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else ROOT
    if base == ROOT:
        COMMANDS_LIST.write_text(commands_list(), "utf-8")
    lay_out(base / "build" / "docs")
    if base != ROOT:  # what Zensical reads must lie in one folder
        shutil.copy(ROOT / "mkdocs.yml", base)
        (base / "cloak_core").symlink_to(ROOT / "cloak_core")
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--clean"]
    if code := subprocess.run(command, cwd=base, check=False).returncode:
        return code
    bring_worker(base / "site")
    print(base / "site" / "index.html")
    return 0


def bring_worker(site: Path) -> None:
    """Put our own script in place of the one from elsewhere, on every page."""
    shutil.copy(ROOT / "tools" / "file-worker.js", site / "assets" / "javascripts")
    for page in site.rglob("*.html"):
        above = "../" * (len(page.relative_to(site).parts) - 1)
        text = page.read_text("utf-8")
        page.write_text(text.replace(SHIM, f"{above}assets/javascripts/file-worker.js"), "utf-8")


def lay_out(pages: Path) -> None:
    """All pages, fresh, in a folder of their own."""
    shutil.rmtree(pages, ignore_errors=True)
    pages.mkdir(parents=True)
    for name in TAKEN:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, pages / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, pages)
    home = (pages / "docs" / "index.md").read_text("utf-8")
    (pages / "docs" / "index.md").unlink()
    (pages / "index.md").write_text(re.sub(r"\]\((?!https?:)", "](docs/", home), "utf-8")
    reference = pages / "docs" / "reference"
    (reference / "commands.md").write_text(commands_page(), "utf-8")
    (reference / "json.md").write_text(json_page(), "utf-8")
    (reference / "python.md").write_text(python_page(), "utf-8")
    (reference / "mistakes.md").write_text(mistakes_page(), "utf-8")
    notebook = pages / "docs" / "notebooks" / "first_cloak.ipynb"
    notebook.with_suffix(".md").write_text(notebook_page(notebook), "utf-8")
    guide = pages / "CONTRIBUTING.md"
    guide.write_text(with_rooms(guide.read_text("utf-8")), "utf-8")
    for page in pages.rglob("*.md"):
        page.write_text(laid_out(page.read_text("utf-8")), "utf-8")


def laid_out(text: str) -> str:
    """The page as the site shows it: pictures open on a click, and a page of wide tables has the whole width."""
    text = PICTURE.sub(r"[\g<0>](\1)", unbroken(text))
    lines = [line for line in text.splitlines() if line]
    of_tables = sum(line.startswith("|") for line in lines) > len(lines) / 3
    return f"---\nhide: [toc]\n---\n\n{text}" if of_tables and WIDE_TABLE.search(text) else text


def with_rooms(text: str) -> str:
    """The guide for contributors with a picture of the rooms below its heading."""
    heading = "## Where to read\n"
    assert text.count(heading) == 1, "CONTRIBUTING.md has no place for the picture of the rooms"
    return text.replace(heading, f"{heading}\n{rooms_svg()}\n")


def unbroken(text: str) -> str:
    """The page with spaces that no line ends at between figures and their unit; code stays as it is."""
    parts = CODE.split(text)
    return "".join(part if i % 2 else UNIT.sub("\\1\u00a0\\2", part) for i, part in enumerate(parts))


def commands_list() -> str:
    """The page of commands as it lies in the repository: a line each."""
    from cloak_core.cli import GROUPS, load
    from cloak_core.commands.help import summary

    lines = ["# Command line", "", "`cloak COMMAND --help-all` lists every option; on the site it stands below."]
    for title, group in GROUPS.items():
        lines += ["", f"## {title}", ""]
        lines += [f"- `{name}`: {re.split(r'[:;] ', summary(load(name).__doc__ or ''))[0]}" for name in group]
    return "\n".join(lines) + "\n"


def commands_page() -> str:
    """The list, and every command's help, as a terminal shows it."""
    os.environ["COLUMNS"] = WIDTH
    from cloak_core.cli import COMMANDS, load
    from cloak_core.commands.parsing import parse

    link = lambda found: f"- [{found[1]}](#cloak-{found[2].replace(' ', '-')}):"
    lines = [re.sub(r"^- (`([\w -]+)`):", link, line) for line in commands_list().splitlines()]
    for name in COMMANDS:
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
            parse(load(name), name, ["--help-all"])
        lines += ["", f"## cloak {name}", "", "```text", *said.getvalue().rstrip().splitlines(), "```"]
    return "\n".join(lines) + "\n"


def json_page() -> str:
    """What each command prints under --json: a table of each schema."""
    told = json.loads((ROOT / "docs" / "schemas.json").read_text("utf-8"))
    lines = ["# What `--json` prints", "", *textwrap.wrap(told["description"], 118), ""]
    lines += ["The same as JSON Schema, one under `$defs` for each command: [schemas.json](../schemas.json).", ""]
    for name, schema in told["$defs"].items():
        title = f"cloak {name}" if name in told["commands"] else name
        lines += [f"## {title}", "", schema["description"], "", "| key | is | what |", "|---|---|---|"]
        rows = schema["properties"].items()
        lines += [_row(key, value, key in schema.get("required", ()), told["commands"]) for key, value in rows]
        if each := schema.get("additionalProperties"):
            lines.append(f"| each SPEC | {each['type']} | {', '.join(f'`{key}`' for key in each['required'])} |")
        lines.append("")
    return "\n".join(lines)


def _row(key: str, schema: dict, required: bool, commands: list[str]) -> str:
    kind = schema.get("type", "")
    if name := schema.get("$ref", "").rpartition("/")[2]:
        kind = f"[{name}](#{('cloak ' * (name in commands) + name).replace(' ', '-')})"
    kind = " or ".join(kind) if isinstance(kind, list) else kind
    return f"| `{key}` | {kind}{'' if required else ', not always there'} | {schema.get('description', '')} |"


def python_page() -> str:
    """The public names of cloak_core, each with its docstring."""
    import cloak_core

    lines = [
        "# Python",
        "",
        "The names that `import cloak_core` has; [the library](../howto/library.md) shows them at work.",
        "",
    ]
    for name in cloak_core.__all__:
        lines += [f"::: cloak_core.{name}", ""]
    return "\n".join(lines)


def notebook_page(path: Path) -> str:
    """A notebook's text and code, without what it printed."""
    cells = json.loads(path.read_text("utf-8"))["cells"]
    told = [f"The notebook itself: [{path.name}]({path.name})."]
    for cell in cells:
        text = "".join(cell["source"])
        told.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
    told[0], told[1] = told[1], told[0]  # the heading comes first
    return "\n\n".join(told) + "\n"


if __name__ == "__main__":
    sys.exit(main())
