"""How Sphinx builds the pages, the executed tour and the API reference: `make docs`."""

import logging
import re
import sys
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import ssac  # noqa: E402

project = "SSAC suite"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
]
root_doc = "README"
include_patterns = ["*.md", "docs/**.md", "docs/**.rst", "results/README.md"]
exclude_patterns = [".*", "cache", "out", "build", "tests", "docs/tour"]
html_theme = "furo"
html_title = project
html_copy_source = False
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_show_copyright = False
html_show_search_summary = False  # it is fetched, which browsers forbid to pages on a disk
python_maximum_signature_line_length = 90
myst_heading_anchors = 3
default_role = "code"
napoleon_google_docstring = False
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
suppress_warnings = ["ref.python"]  # `ssac` offers names of its modules again
sphinx_gallery_conf = {  # runs the tour; an error in it ends the build
    "examples_dirs": ["docs/tour"],
    "gallery_dirs": ["docs/generated/tour"],
    "filename_pattern": r"tour\.py",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
    "write_computation_times": False,
}
autodoc_default_options = {"members": True}

logging.getLogger("OpenGL").setLevel(logging.WARNING)

API = "docs/generated/api"
CHAPTERS = {
    "Use": "docs/generated/tour/tour docs/sync docs/network docs/compare docs/refusal"
    " docs/uncertainty docs/security CHANGELOG",
    "Reproduce": "docs/results results/README docs/physical docs/outdoor docs/real docs/speed",
    "Extend": f"docs/simulate docs/sensor docs/methods docs/sweeps docs/testing CONTRIBUTING"
    f" {API}/ssac {API}/index",
    "Understand": "docs/tangency docs/architecture",
}
"""The navigation, by reader. It hangs from the README, where only Sphinx shall see it."""

# `ssac` imports a name when it is asked for; autodoc looks at what is there.
vars(ssac).update({name: getattr(ssac, name) for name in ssac.__all__})


def write_reference(app: Sphinx) -> None:
    """Write the source of the API reference: a page for each folder, a section for each module."""
    target = ROOT / API
    target.mkdir(parents=True, exist_ok=True)
    pages = []
    for package in ("ssac", "sim", "experiments"):
        for folder in sorted({path.parent for path in (ROOT / package).rglob("*.py")}):
            page = ".".join(folder.relative_to(ROOT).parts)
            modules = [f"{page}.{path.stem}" for path in sorted(folder.glob("[!_]*.py"))]
            sections = [f"{name}\n{'-' * len(name)}\n\n.. automodule:: {name}" for name in modules]
            title = "Python: ssac" if page == "ssac" else page
            head = f"{title}\n{'=' * len(title)}\n\n.. automodule:: {page}"
            (target / f"{page}.rst").write_text("\n\n".join([head, *sections, ""]))
            pages.append(page)
    listed = "\n   ".join(page for page in pages if page != "ssac")
    head = "All modules\n===========\n\n.. toctree::\n   :maxdepth: 1\n"
    (target / "index.rst").write_text(f"{head}\n   {listed}\n")


def linked(text: str) -> str:
    """Make links of pages that a plain text names."""
    return re.sub(r"(`?)\bdocs/(\w+)\.md\1", r":doc:`/docs/\2`", text)


def complete(app: Sphinx, page: str, source: list[str]) -> None:
    """Call linked pages by their titles, and append the navigation to the README."""
    if page.startswith("docs/generated"):
        source[0] = linked(source[0])
    source[0] = re.sub(r"\[[\w./]+\.md\]\(", "[](", source[0])
    if page == root_doc:
        for caption, pages in CHAPTERS.items():
            lines = ["```{toctree}", ":hidden:", f":caption: {caption}", "", *pages.split(), "```"]
            source[0] += "\n".join(["\n", *lines, ""])


def plain(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Take a docstring as plain words: markup only in `code`, and indented blocks as they are."""
    text = linked("\n".join(lines))
    summary, *sections = re.split(r"(?m)^(?=\w+\n---+$)", text, maxsplit=1)
    blocks = re.split(r"(?m)(\A|\n\n)((?:^ {4}.*\n*)+)", summary)
    for n in range(0, len(blocks), 3):  # text, what is before a block, the block
        words = re.split(r"(`[^`]*`)", blocks[n])
        words[::2] = (re.sub(r"([*|]|(?<=\w)_(?!\w))", r"\\\1", word) for word in words[::2])
        blocks[n] = "".join(words)
        if n:
            blocks[n - 2] = "\n\n::\n\n"
    if what in ("attribute", "data", "property"):
        blocks[0] = f":{blocks[0]}"  # or napoleon takes what is before a colon for a type
    lines[:] = "".join([*blocks, *sections]).split("\n")


def shallow(app: Sphinx, page: str, template: str, context: dict[str, Any], tree: object) -> None:
    """Limit the navigation to the levels that it has: the theme copies all objects' entries."""
    toctree = context["toctree"]
    context["toctree"] = lambda **options: toctree(**{**options, "maxdepth": 2})


def take_page(app: Sphinx, error: Exception | None) -> None:
    """Lay the page that the tour wrote beside the tour."""
    page = ROOT / "docs" / "tour" / "report.html"
    if error is None and page.exists():
        page.replace(Path(app.outdir) / "docs" / "generated" / "tour" / page.name)


def short_signature(
    app: Sphinx, what: str, name: str, obj: object, options: object, arguments: str, returned: str
) -> tuple[str, str]:
    """Write arrays as their annotations do, and a default that is no literal as dots."""
    array = r"~?(?:numpy[.])?ndarray\[.*?dtype\[~?(?:numpy[.])?(\w+)\]\]"
    short = (re.sub(array, r"NDArray[\1]", one or "") for one in (arguments, returned))
    arguments, returned = (re.sub(r"<[^<>]*(<[^<>]*>)?[^<>]*>", "...", one) for one in short)
    return arguments or None, returned or None


def with_comments_of_fields(analyzer: ModuleAnalyzer, source: str, *names: str) -> None:
    """Read a module; what stands behind a dataclass's field, as a comment, is that field's text."""
    comment = r"(?m)^( {4}\w+: .*?)  # (?:type: \S+ # )?(?!type:|noqa|fmt:)"
    commented = re.sub(comment, r"\1  #: ", source)
    read_module(analyzer, commented, *names)


read_module = ModuleAnalyzer.__init__
ModuleAnalyzer.__init__ = with_comments_of_fields


def setup(app: Sphinx) -> None:
    """Connect them."""
    app.connect("autodoc-process-signature", short_signature)
    app.connect("build-finished", take_page)
    app.connect("html-page-context", shallow, priority=400)  # before the theme
    app.connect("builder-inited", write_reference)
    app.connect("source-read", complete)
    app.connect("autodoc-process-docstring", plain, priority=400)
