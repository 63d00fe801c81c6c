"""Run the README's example; write what it prints between the comments that hold its place."""

import os
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
SIMULATE = "ssac simulate pair --angle 90 --duration 10 --t-d 0.05 --seed 0"
SYNC = "ssac sync pair/cam1.h5 pair/cam2.h5 --rig pair/rig.yaml"
_PLACE = re.compile(r"<!--example-->\n.*?<!--/example-->", re.DOTALL)


def main() -> None:
    """Rewrite the README's example."""
    sys.path.insert(0, str(ROOT))
    from ssac.files.whole_file import whole_file

    readme = ROOT / "README.md"
    text = readme.read_text(encoding="utf-8")
    block = f"<!--example-->\n{example()}<!--/example-->"
    with whole_file(readme) as temporary:
        temporary.write_text(_PLACE.sub(lambda _: block, text), encoding="utf-8")


def example() -> str:
    """Run both commands in a new folder; return them and what they print, as code in Markdown."""
    with TemporaryDirectory() as folder:
        shown = [f"$ {command}\n{printed(command, Path(folder))}" for command in (SIMULATE, SYNC)]
    lines = "".join(shown).splitlines()
    return "\n" + "".join(f"    {line}".rstrip() + "\n" for line in lines) + "\n"


def printed(command: str, folder: Path) -> str:
    """Run an `ssac` command in a folder; return its standard output."""
    done = subprocess.run(
        [sys.executable, "-m", "experiments", *command.split()[1:]],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    return done.stdout


def shown_in(readme: str) -> str:
    """Return the example as it stands in a README's text."""
    found = _PLACE.search(readme)
    if not found:
        raise ValueError("README.md: no place for the example: <!--example--> to <!--/example-->")
    return found[0].removeprefix("<!--example-->\n").removesuffix("<!--/example-->")


if __name__ == "__main__":
    main()
