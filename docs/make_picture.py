"""The README's looping picture: the first seconds of one simulated run, from its overlay video.

python docs/make_picture.py FOLDER        a folder that `rcmservo run` wrote; writes servo.webp
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
from PIL import Image

SECONDS, RATE, SIZE = 3.0, 15.0, (512, 384)
"""Length and pictures/s of the loop, and px of each picture."""
LAST_MS = 2000
"""How long the last picture stays."""


def pictures(film: Path) -> Iterator[Image.Image]:
    """Pictures of the film at the loop's rate."""
    video = cv2.VideoCapture(str(film))
    stride = video.get(cv2.CAP_PROP_FPS) / RATE
    for k in range(round(SECONDS * RATE)):
        video.set(cv2.CAP_PROP_POS_FRAMES, round(k * stride))
        small = cv2.resize(video.read()[1], SIZE, interpolation=cv2.INTER_AREA)
        yield Image.fromarray(cv2.cvtColor(small, cv2.COLOR_BGR2RGB))


def main(folder: Path) -> None:
    first, *others = pictures(folder / "overlay.webm")
    to = Path(__file__).with_name("servo.webp")
    durations = [round(1000 / RATE)] * len(others) + [LAST_MS]
    first.save(to, save_all=True, append_images=others, duration=durations, loop=0, quality=70)
    print(to)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
