"""Follow what moves most in a video of a camera that stands still, and write its track file.

    .venv/bin/python docs/track_video.py VIDEO.mp4 cam1.csv

A starting point: any detector or tracker will do that writes the same columns. It takes what
differs from the background for moving, and of that the largest connected region in each frame; its
centre is the position. Frame k is taken to be at k / fps seconds of the camera's clock, so a video
of a variable frame rate needs its real time stamps instead.
"""

import argparse
import sys
from itertools import count
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
HISTORY_FRAMES = 300
LEARNING_S = 1.0
"""The background is not yet known in the first second, which is left out."""


def main() -> None:
    """Follow the object; write the track."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("video", type=Path, help="any file that OpenCV can read")
    parser.add_argument("track", type=Path, help="track file to write (.csv)")
    parser.add_argument("--min-area", type=int, default=12, help="least area of the object [px]")
    parser.add_argument("--fps", type=float, help="frames per second, where the file is wrong")
    arguments = parser.parse_args()
    sys.path.insert(0, str(ROOT))  # the packages of this tree, wherever it is run from
    from ssac.errors import SsacError
    from ssac.files.track_files import save_track
    from ssac.files.whole_file import check_targets
    from ssac.points import PointTrack

    try:
        check_targets([arguments.track], [arguments.video])
    except SsacError as error:
        parser.error(str(error))
    times_s, points_px = followed(arguments.video, arguments.min_area, arguments.fps)
    if len(times_s) == 0:
        parser.error(f"{arguments.video}: nothing moves in it, or it is no video that can be read")
    save_track(arguments.track, PointTrack(times_s, points_px))
    print(f"{arguments.track}: {len(times_s)} points to {times_s[-1]:.3f} s")


def followed(
    video: Path, min_area_px: int, fps: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s], (N,), and centres [px], (N, 2), of the largest moving region."""
    capture = cv2.VideoCapture(str(video))
    fps = fps or capture.get(cv2.CAP_PROP_FPS)
    background = cv2.createBackgroundSubtractorMOG2(HISTORY_FRAMES, detectShadows=False)
    times_s, points_px = [], []
    for k in count():
        read, image = capture.read()
        if not read:
            break
        moving = cv2.medianBlur(background.apply(image), 3)  # without single pixels
        _, _, boxes, centres = cv2.connectedComponentsWithStats(moving)
        areas = boxes[1:, cv2.CC_STAT_AREA]  # 0 is the background
        if k >= LEARNING_S * fps and len(areas) and areas.max() >= min_area_px:
            times_s.append(k / fps)
            points_px.append(centres[1 + areas.argmax()])
    capture.release()
    return np.array(times_s), np.array(points_px).reshape(-1, 2)


if __name__ == "__main__":
    main()
