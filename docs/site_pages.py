"""What the site shows that does not lie in docs/ (a hook of mkdocs, see mkdocs.yml).

The pages are written for the repository: they link to its files and folders by relative paths. On the
site the README is the first page, and every file or folder that a page links to becomes a page with its
text, so that the same links lead somewhere in both places.
"""

from __future__ import annotations

import json
import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parent.parent
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
}
"""Pages outside docs/ by their names on the site."""

SHOWN_AS_THEY_ARE = (".md", ".png", ".webp")
_LINK = re.compile(r"(\]\()([^)#\s]+)(#[^)\s]*)?(?=\))")
_LANGUAGES = {".py": "python", ".yaml": "yaml", ".toml": "toml"}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages outside docs/, and a page for each file or folder that a page links to."""
    for source, name in PAGES.items():
        text = (ROOT / source).read_text("utf-8")
        files.append(File.generated(config, name, content=text))
    shown = {
        path: name
        for file in files.documentation_pages()
        for path in _linked(file.content_string, _origin(file.src_uri))
        if (name := _on_site(path)).startswith("source/")
    }
    for path, name in sorted(shown.items()):
        files.append(File.generated(config, name, content=_page_of(path)))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Let links lead to where the site has what they name in the repository."""
    here = page.file.src_uri
    if here.startswith("source/") and not here.endswith(".ipynb.md"):
        return markdown  # code

    def moved(link: re.Match[str]) -> str:
        before, target, anchor = link.groups()
        path = _resolved(target, _origin(here))
        if path is None:
            return link[0]
        return before + posixpath.relpath(_on_site(path), posixpath.dirname(here)) + (anchor or "")

    return _LINK.sub(moved, markdown)


def _origin(name: str) -> str:
    """The path in the repository of a page of the site."""
    if name.startswith("source/"):
        return name.removeprefix("source/").removesuffix(".md")
    return next((source for source, there in PAGES.items() if there == name), f"docs/{name}")


def _on_site(path: str) -> str:
    """The name on the site of a path in the repository."""
    if path in PAGES:
        return PAGES[path]
    if path.startswith("docs/") and path.endswith(SHOWN_AS_THEY_ARE):
        return path.removeprefix("docs/")
    return f"source/{path}.md"


def _resolved(target: str, origin: str) -> str | None:
    """The path in the repository that a link of a page there names; None if it names none."""
    path = posixpath.normpath(posixpath.join(posixpath.dirname(origin), target))
    return path if "://" not in target and (ROOT / path).exists() else None


def _linked(markdown: str, origin: str) -> list[str]:
    found = (_resolved(link[2], origin) for link in _LINK.finditer(markdown))
    return [path for path in found if path is not None]


def _page_of(path: str) -> str:
    """A page with the text of a file, or of the files of a folder."""
    place = ROOT / path
    inside = place.rglob("*") if place.is_dir() else [place]
    files = sorted(file for file in inside if file.is_file() and "__pycache__" not in file.parts)
    return "\n\n".join([f"# `{path}`", *(_text_of(file, place) for file in files)])


def _text_of(file: Path, place: Path) -> str:
    if file.suffix == ".ipynb":
        return _cells_of(file)
    heading = f"## `{file.relative_to(place)}`\n\n" if place.is_dir() else ""
    return heading + _fenced(file.read_text("utf-8"), _LANGUAGES.get(file.suffix, "text"))


def _cells_of(notebook: Path) -> str:
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    texts = ((cell["cell_type"], "".join(cell["source"])) for cell in cells)
    return "\n\n".join(_fenced(text, "python") if kind == "code" else text for kind, text in texts)


def _fenced(text: str, language: str) -> str:
    return f"````{language}\n{text.rstrip()}\n````"
