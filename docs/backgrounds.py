"""Draw the textured backgrounds of `experiments/configs/backgrounds/` by a seed.

    python docs/backgrounds.py

They are what a camera may have behind a drone: clouds, leaves, houses. Each has sixteen greys, so
that the files are small, and the resolution of the default cameras.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parents[1] / "experiments" / "configs" / "backgrounds"
WIDTH, HEIGHT = 346, 260
N_GREYS = 16


def octaves(cells_px: Sequence[int], rng: np.random.Generator) -> FloatArray:
    """Sum smooth random images whose spots have these sizes, stronger where larger; 0 to 1."""
    total = np.zeros((HEIGHT, WIDTH))
    for cell_px in cells_px:
        coarse = rng.random((HEIGHT // cell_px + 2, WIDTH // cell_px + 2))
        fine = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
        total += cell_px**0.5 * fine
    low, high = np.quantile(total, (0.01, 0.99))
    return np.clip((total - low) / (high - low), 0.0, 1.0)


def houses(rng: np.random.Generator) -> FloatArray:
    """Fronts of different greys side by side before the sky, with rows of dark windows."""
    grey = np.full((HEIGHT, WIDTH), 0.9)
    x = 0
    while x < WIDTH:
        width, top = int(rng.integers(35, 80)), int(rng.integers(20, 140))
        grey[top:, x : x + width] = rng.uniform(0.25, 0.75)
        for row in range(top + 8, HEIGHT - 12, 24):
            for column in range(x + 6, min(x + width, WIDTH) - 8, 14):
                grey[row : row + 12, column : column + 7] = rng.uniform(0.05, 0.2)
        x += width
    return grey


def main() -> None:
    """Write them."""
    pictures = {
        "clouds": 0.6 + 0.35 * octaves((24, 48, 96), np.random.default_rng(1)),
        "leaves": 0.15 + 0.6 * octaves((4, 8, 16, 32), np.random.default_rng(2)),
        "houses": houses(np.random.default_rng(3)),
    }
    FOLDER.mkdir(exist_ok=True)
    for name, grey in pictures.items():
        steps = np.rint(grey * (N_GREYS - 1)) / (N_GREYS - 1)
        cv2.imwrite(str(FOLDER / f"{name}.png"), np.rint(255 * steps).astype(np.uint8))


if __name__ == "__main__":
    main()
