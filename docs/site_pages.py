"""Pages of the site that are not files in docs/ (an mkdocs hook, see mkdocs.yml).

Pages link to files and folders of the repository by relative paths. On the site the README is the first
page, and each linked file or folder becomes a page with its text, so that links work in both places. The
list of components and the pages on Python interfaces are generated from the code.
"""

from __future__ import annotations

import json
import posixpath
import re
import runpy
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
"""Pages outside docs/, and their names on the site."""
COMPONENTS = "components.md"

SHOWN_UNCHANGED = (".md", ".png", ".webp")
_LINK = re.compile(r"(\]\()([^)#\s]+)(#[^)\s]*)?(?=\))")
_LANGUAGES = {".py": "python", ".yaml": "yaml", ".toml": "toml"}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated page, the pages outside docs/, and a page for each linked file or folder."""
    reference = runpy.run_path(str(ROOT / "docs" / "make_reference.py"))
    files.append(File.generated(config, COMPONENTS, content=reference["page"]()))
    interfaces = runpy.run_path(str(ROOT / "docs" / "api_pages.py"))["pages"]()
    for name, text in interfaces.items():
        files.append(File.generated(config, name, content=text))
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
    """Rewrite links to repository paths as links to pages of the site."""
    here = page.file.src_uri
    if here.startswith("source/") and not here.endswith(".ipynb.md"):
        return markdown  # code

    def moved(link: re.Match[str]) -> str:
        before, target, anchor = link.groups()
        path = _resolved(target, _origin(here))
        if path is None:
            return link[0]
        name = _on_site(path)
        if name.startswith("source/"):  # shown as text, without headings
            anchor = None
        return before + posixpath.relpath(name, posixpath.dirname(here)) + (anchor or "")

    return _LINK.sub(moved, markdown)


def _origin(name: str) -> str:
    """Return the repository path of a page of the site."""
    if name.startswith("source/"):
        return name.removeprefix("source/").removesuffix(".md")
    return next((source for source, there in PAGES.items() if there == name), f"docs/{name}")


def _on_site(path: str) -> str:
    """Return the name on the site of a repository path."""
    if path in PAGES:
        return PAGES[path]
    if path.startswith("docs/") and path.endswith(SHOWN_UNCHANGED):
        return path.removeprefix("docs/")
    return f"source/{path}.md"


def _resolved(target: str, origin: str) -> str | None:
    """Return the repository path of a link target, or None if it is not a file there."""
    path = posixpath.normpath(posixpath.join(posixpath.dirname(origin), target))
    return path if "://" not in target and (ROOT / path).exists() else None


def _linked(markdown: str, origin: str) -> list[str]:
    found = (_resolved(link[2], origin) for link in _LINK.finditer(markdown))
    return [path for path in found if path is not None]


def _page_of(path: str) -> str:
    """Return a page with the text of a file, or of all files of a folder."""
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
