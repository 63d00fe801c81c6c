"""Pages, a tour and the three packages in; one folder of HTML out, which needs no network.

`make docs` runs it. The tour, a script of cells that begin with `# %%`, is executed, and what its
cells print and draw stands below them. An error in a cell ends the build.
"""

import argparse
import base64
import io
import os
import re
import shutil
import sys
import warnings
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from html import escape
from importlib import import_module
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("ssac", "sim", "experiments")
_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 52em; padding: 0 1em }
pre { background: #f6f6f4; overflow-x: auto; padding: .7em 1em }
pre.printed { background: none; border-left: 3px solid #bbb }
code { font-size: .9em } img { max-width: 100% } table { border-collapse: collapse }
td, th { border: 1px solid #ddd; padding: .2em .6em; text-align: left } nav a { margin-right: 1em }
"""


@dataclass(frozen=True)
class Cell:
    """A part of the tour: text in Markdown, or code."""

    is_text: bool
    source: str
    line: int  # its first one in the file


@dataclass(frozen=True)
class Output:
    """What a cell printed and drew."""

    printed: str
    pictures: list[bytes]  # PNG


def main() -> None:
    """Build everything, or only run the tour."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "docs", help="folder to write")
    out = parser.parse_args().out
    sys.path.insert(0, str(ROOT))  # the packages of this tree, wherever it is run from
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    save_pages(out)
    print(f"docs: {out / 'tour.html'}", file=sys.stderr)
    cells = list(cells_of((ROOT / "docs" / "tour.py").read_text(encoding="utf-8")))
    (out / "tour.html").write_text(page_html("A guided tour", tour_html(cells)), encoding="utf-8")
    save_reference(out / "api")
    print(f"docs: {out / 'index.html'}", file=sys.stderr)


def cells_of(script: str) -> Iterator[Cell]:
    """Split a script at its lines that begin with `# %%`; comments of a text cell lose their #."""
    parts = re.split(r"^(# %%.*)\n", script, flags=re.MULTILINE)
    line = 1 + parts[0].count("\n")
    for head, body in zip(parts[1::2], parts[2::2], strict=True):
        is_text = "[markdown]" in head
        source = re.sub(r"^# ?", "", body, flags=re.MULTILINE) if is_text else body
        yield Cell(is_text, source.strip("\n"), line + 1)
        line += 1 + body.count("\n")


def run_cells(cells: list[Cell]) -> list[Output | None]:
    """Execute the cells of code in one namespace; None stands for the output of a text."""
    import matplotlib.pyplot as plt

    namespace: dict[str, object] = {"__name__": "__main__"}
    outputs: list[Output | None] = []
    for cell in cells:
        if cell.is_text:
            outputs.append(None)
            continue
        padded = "\n" * (cell.line - 1) + cell.source  # so that a traceback has the file's lines
        with redirect_stdout(io.StringIO()) as printed:
            exec(compile(padded, str(ROOT / "docs" / "tour.py"), "exec"), namespace)
        pictures = []
        for number in plt.get_fignums():
            picture = io.BytesIO()
            plt.figure(number).savefig(picture, format="png", dpi=110)
            pictures.append(picture.getvalue())
        plt.close("all")
        outputs.append(Output(printed.getvalue(), pictures))
    return outputs


def tour_html(cells: list[Cell]) -> str:
    """Run the tour; lay out its cells, each with what it gave."""
    from pygments import highlight
    from pygments.formatters import HtmlFormatter
    from pygments.lexers import PythonLexer

    looks = HtmlFormatter(noclasses=True, nobackground=True)
    parts = []
    for cell, output in zip(cells, run_cells(cells), strict=True):
        if output is None:
            parts.append(markdown_html(cell.source))
            continue
        parts.append(highlight(cell.source, PythonLexer(), looks))
        if output.printed:
            parts.append(f'<pre class="printed">{escape(output.printed)}</pre>')
        for picture in output.pictures:
            data = base64.b64encode(picture).decode()
            parts.append(f'<img alt="" src="data:image/png;base64,{data}">')
    return "\n".join(parts)


def save_pages(out: Path) -> None:
    """Write each Markdown page as HTML, at its place in the tree, with the pictures it shows."""
    sources = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), ROOT / "results" / "README.md"]
    for source in sources:
        text = source.read_text(encoding="utf-8")
        target = out / source.relative_to(ROOT).with_suffix(".html")
        target.parent.mkdir(parents=True, exist_ok=True)
        for link in re.findall(r"\]\(([^)#\s:]+)\)", text):
            linked = (source.parent / link).resolve()
            if linked.suffix != ".md" and linked.is_file():
                copy = out / linked.relative_to(ROOT)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(linked, copy)
        text = re.sub(r"\]\((?!http)([^)\s]+)\.md", r"](\1.html", text)
        depth = len(target.relative_to(out).parts) - 1
        title = text.split("\n", 1)[0].lstrip("# ")
        target.write_text(page_html(title, markdown_html(text), "../" * depth), encoding="utf-8")
    (out / "README.html").replace(out / "index.html")


def markdown_html(text: str) -> str:
    """Render Markdown with tables; the comments that hold numbers stay comments."""
    from markdown_it import MarkdownIt

    return str(MarkdownIt("commonmark", {"html": True}).enable("table").render(text))


def page_html(title: str, body: str, up: str = "") -> str:
    """Lay out a page; `up` leads to the folder of the index."""
    links = {"index.html": "overview", "tour.html": "tour", "api/index.html": "API"}
    links |= {"docs/architecture.html": "architecture", "docs/results.html": "results"}
    nav = "".join(f'<a href="{up}{link}">{name}</a>' for link, name in links.items())
    body = body.replace('href="README.html', 'href="index.html')
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}'
        f"</title><style>{_STYLE}</style></head>\n<body><nav>{nav}</nav>\n{body}\n</body></html>\n"
    )


def save_reference(out: Path) -> None:
    """Write the API reference of the three packages: every public name with its docstring."""
    os.environ["PDOC_ALLOW_EXEC"] = "1"  # or it warns that a library asks for the machine's name
    import pdoc
    import pdoc.render
    from pdoc.extract import walk_specs

    # Of a package that lists its public names pdoc shows these alone: its modules are asked for.
    files = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    wanted = list(PACKAGES)
    found = set(walk_specs(wanted))
    for path in files:
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        if name not in found:
            wanted.append(name)
            found.update(walk_specs([name]))
    ssac = import_module("ssac")  # imports a name when it is asked for; pdoc looks at what is there
    vars(ssac).update({name: getattr(ssac, name) for name in ssac.__all__})
    pdoc.render.configure(docformat="numpy", footer_text="SSAC suite")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a name that is not found has a page without its docstring
        pdoc.pdoc(*wanted, output_directory=out)


if __name__ == "__main__":
    main()
