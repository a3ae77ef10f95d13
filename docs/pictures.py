"""Pictures of runs -> one picture, side by side: ``python docs/pictures.py OUT PNG...``."""

import sys

from PIL import Image


def main(out: str, *paths: str) -> None:
    """Join the pictures, all of the first one's size, from left to right."""
    pictures = [Image.open(path) for path in paths]
    width, height = pictures[0].size
    joined = Image.new("RGB", (width * len(pictures), height))
    for i, picture in enumerate(pictures):
        joined.paste(picture, (i * width, 0))
    joined.quantize(128).save(out, optimize=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
