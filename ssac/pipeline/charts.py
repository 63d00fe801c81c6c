"""Charts as HTML: curves and dots in an SVG that stretches, labels beside it that do not.

Python makes the paths, in a box of 1000 x 1000; the page's style has the colours, for a light and a
dark ground, and the widths of lines, which stay as they are on a narrow screen.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.ticker import MaxNLocator

from ssac.arrays import Array

_BOX = 1000.0


@dataclass(frozen=True)
class Mark:
    """One path, or one row of labels, of a chart."""

    look: str  # a class of the page's style
    path: str
    name: str = ""  # in the legend; empty: not there


@dataclass(frozen=True)
class Chart:
    """What is drawn over a range of x and of y, and what it says in words."""

    title: str
    words: str  # what is to be seen
    x_label: str
    y_label: str
    x: tuple[float, float]
    y: tuple[float, float]  # lower and upper edge: of images the lower one is larger
    shape: str = ""  # width / height, where both axes are of one unit
    marks: list[Mark] = field(default_factory=list)
    png: str = ""  # a picture below all marks, in base64
    rows: tuple[str, ...] = ()  # names in place of numbers along y, from above

    @property
    def ticks(self) -> tuple[list[tuple[float, str]], list[tuple[float, str]]]:
        """Places along x and y, in percent from the left and from above, and their labels."""
        along_x = [
            (100.0 * (v - self.x[0]) / (self.x[1] - self.x[0]), s) for v, s in _ticks(*self.x)
        ]
        if self.rows:
            n = len(self.rows)
            return along_x, [(100.0 * (k + 0.5) / n, name) for k, name in enumerate(self.rows)]
        low, high = self.y
        return along_x, [(100.0 * (high - v) / (high - low), s) for v, s in _ticks(*self.y)]

    @property
    def legend(self) -> list[Mark]:
        """Marks with a name."""
        return [mark for mark in self.marks if mark.name]

    def line(self, look: str, x: Array, y: Array, name: str = "") -> None:
        """Draw a curve through points (n,), broken where one is not finite."""
        parts, is_open = list[str](), False
        for a, b in zip(*self._placed(x, y), strict=True):
            if not (np.isfinite(a) and np.isfinite(b)):
                is_open = False
                continue
            parts.append(f"{'L' if is_open else 'M'}{a:.1f} {b:.1f}")
            is_open = True
        self.marks.append(Mark(f"line {look}", "".join(parts), name))

    def band(self, look: str, x: Array, low: Array, high: Array, name: str = "") -> None:
        """Fill between two curves (n,)."""
        there, back = (
            zip(*self._placed(x, low), strict=True),
            zip(*self._placed(x, high), strict=True),
        )
        points = [*there, *list(back)[::-1]]
        path = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in points) + "Z" if len(points) else ""
        self.marks.append(Mark(f"band {look}", path, name))

    def dots(self, look: str, x: Array, y: Array, name: str = "") -> None:
        """Draw points (n,), those that are finite and in the box."""
        a, b = self._placed(x, y)
        with np.errstate(invalid="ignore"):
            shown = (a >= 0.0) & (a <= _BOX) & (b >= 0.0) & (b <= _BOX)
        places = zip(a[shown], b[shown], strict=True)
        path = "".join(f"M{left:.0f} {top:.0f}h0" for left, top in places)
        self.marks.append(Mark(f"dots {look}", path, name))

    def upright(self, look: str, x: float, name: str = "") -> None:
        """Draw a line from below to above."""
        self.line(look, np.array([x, x]), np.array(self.y), name)

    def bars(self, look: str, edges: Array, heights: Array, name: str = "") -> None:
        """Draw bars between edges (n + 1,), from zero on."""
        x = np.repeat(edges, 2)
        y = np.concatenate([[0.0], np.repeat(heights, 2), [0.0]])
        self.band(look, x, np.zeros(len(x)), y, name)

    def _placed(self, x: Array, y: Array) -> tuple[Array, Array]:
        (left, right), (low, high) = self.x, self.y
        with np.errstate(invalid="ignore"):
            a = _BOX * (np.asarray(x) - left) / (right - left)
            b = _BOX * (high - np.asarray(y)) / (high - low)
        return a, b


def spread(values: Array | Sequence[float], margin: float = 0.05) -> tuple[float, float]:
    """Give a range that holds all finite values (n,), with a margin as a share of it."""
    finite = np.asarray(values)[np.isfinite(values)]
    if len(finite) == 0:
        return 0.0, 1.0
    low, high = float(np.min(finite)), float(np.max(finite))
    pad = margin * (high - low) if high > low else 0.5 * abs(low) or 0.5
    return low - pad, high + pad


def _ticks(low: float, high: float) -> list[tuple[float, str]]:
    """Give round numbers within a range, whichever end is the larger, with as many digits each."""
    low, high = min(low, high), max(low, high)
    values = [
        float(v)
        for v in MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
        if low <= v <= high
    ]
    step = values[1] - values[0] if len(values) > 1 else 1.0
    digits = max(0, -int(np.floor(np.log10(step) + 1e-9)))
    digits = min(digits + (round(step * 10**digits, 6) % 1 > 0), 9)
    return [(value, f"{value + 0.0:.{digits}f}") for value in values]
