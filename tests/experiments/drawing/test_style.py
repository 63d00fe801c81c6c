import io

import pytest
from matplotlib.figure import Figure
from PIL import Image

from experiments.drawing.style import WIDTH_IN, method_looks
from experiments.lab.files import DPI, png_bytes
from ssac.pipeline.registry import METHODS


def line_figure() -> Figure:
    figure = Figure(figsize=(WIDTH_IN, 2.0))
    figure.subplots().plot([0.0, 1.0], [0.0, 1.0], color="#D55E00", lw=20)
    return figure


def test_a_picture_is_the_same_bytes_every_time() -> None:
    assert png_bytes(line_figure()) == png_bytes(line_figure())


def test_a_picture_says_nothing_of_time_and_program() -> None:
    with Image.open(io.BytesIO(png_bytes(line_figure()))) as image:
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
