"""The README's picture: three moments of one simulated run, from its overlay video.

python docs/make_picture.py FOLDER        a folder that `rcmservo run` wrote
"""

import sys
from pathlib import Path

import cv2
import numpy as np

MOMENTS = (0.5, 2.0, 8.0)
"""s into the run: exploring, on the way, there."""


def main(folder: Path) -> None:
    video = cv2.VideoCapture(str(folder / "overlay.webm"))
    rate = video.get(cv2.CAP_PROP_FPS)
    pictures = []
    for moment in MOMENTS:
        video.set(cv2.CAP_PROP_POS_FRAMES, round(moment * rate))
        pictures.append(cv2.resize(video.read()[1], (480, 360), interpolation=cv2.INTER_AREA))
    to = Path(__file__).with_name("servo.jpg")
    cv2.imwrite(str(to), np.hstack(pictures), [cv2.IMWRITE_JPEG_QUALITY, 85])
    print(to)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
