from pathlib import Path

import pytest
from matplotlib.figure import Figure
from PIL import Image

from experiments.drawing.style import WIDTH_IN, method_looks
from experiments.lab.files import DPI, save_png
from ssac.pipeline.registry import METHODS


def line_figure() -> Figure:
    figure = Figure(figsize=(WIDTH_IN, 2.0))
    figure.subplots().plot([0.0, 1.0], [0.0, 1.0], color="#D55E00", lw=20)
    return figure


def test_a_picture_is_the_same_bytes_every_time(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        save_png(line_figure(), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_picture_says_nothing_of_time_and_program(tmp_path: Path) -> None:
    save_png(line_figure(), tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (WIDTH_IN * DPI, 2.0 * DPI)
        assert not {"Software", "Creation Time", "date"} & set(image.info)
        # The palette holds what was drawn, within what its 96 colours allow.
        middle = image.convert("RGB").getpixel((image.width // 2, image.height // 2))
        assert middle == pytest.approx((0xD5, 0x5E, 0x00), abs=4)


def test_no_two_methods_look_alike() -> None:
    looks = method_looks([*METHODS, "theirs", "others"])
    assert len(set(looks.values())) == len(looks)


def test_a_method_looks_the_same_in_every_company() -> None:
    assert method_looks(["ssac"])["ssac"] == method_looks([*METHODS])["ssac"]
    known, unknown = method_looks(["ssac-known", "ssac"]).values()
    assert known.color == unknown.color
    assert known.face != unknown.face
