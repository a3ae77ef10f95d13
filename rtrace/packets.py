"""Packets of rays: which pixels of a picture go together, and in which order their packets are traced."""

import math

import numpy as np

from rtrace.camera import pixel_order
from rtrace.shooting import Shooting


def shot_pixels(shooting: Shooting) -> np.ndarray:
    """Return the pixels of a picture in the order in which their rays are traced, (n,) uint32: y * width + x.

    In packets: the pixels of an aligned square, in their own order; the squares in the order of their first pixels.
    """
    pixels = pixel_order(shooting.order, shooting.width, shooting.height, shooting.seed)
    if shooting.packet == 1:
        return pixels
    _, first, square = np.unique(packet_numbers(pixels, shooting), return_index=True, return_inverse=True)
    return pixels[np.argsort(first[square], kind="stable")]


def packet_numbers(pixels: np.ndarray, shooting: Shooting) -> np.ndarray:
    """Return the number of each pixel's packet, (n,) uint32: its square, counted row by row."""
    side = np.uint32(math.isqrt(shooting.packet))
    x, y = pixels % np.uint32(shooting.width), pixels // np.uint32(shooting.width)
    return (y // side) * np.uint32(-(-shooting.width // int(side))) + x // side


def packet_starts(pixels: np.ndarray, shooting: Shooting) -> np.ndarray | range:
    """Return where each packet begins among pixels that ``shot_pixels`` has put in order, and, last, their number."""
    if shooting.packet == 1:
        return range(len(pixels) + 1)
    number = packet_numbers(pixels, shooting)
    return np.concatenate([[0], np.flatnonzero(np.diff(number)) + 1, [len(pixels)]])
