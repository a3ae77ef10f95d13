"""The orders of pixels, which must never change: written out, and from the bits of x and y one pixel at a time."""

import hashlib

import numpy as np
import pytest

from rtrace.camera import pixel_order

SIZES = [(8, 8), (64, 64), (5, 3), (3, 5), (7, 12), (100, 1), (1, 100), (65, 130), (130, 65), (200, 72)]

# Picture of 5 x 3: numbers are y * 5 + x.
GOLDEN = {
    "scanline": [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14],
    "tile": [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14],
    "morton": [0, 1, 5, 6, 2, 3, 7, 8, 10, 11, 12, 13, 4, 9, 14],
    "hilbert": [0, 5, 6, 1, 2, 3, 8, 7, 12, 13, 11, 10, 14, 9, 4],
}
# Picture of 10 x 9: beyond a square of 8 x 8 both ways.
GOLDEN_WIDE = {
    "tile": [10 * y + x for columns in (range(8), (8, 9)) for y in range(8) for x in columns] + list(range(80, 90)),
    "morton": [
        0, 1, 10, 11, 2, 3, 12, 13, 20, 21, 30, 31, 22, 23, 32, 33, 4, 5, 14, 15, 6, 7, 16, 17, 24, 25, 34, 35, 26, 27, 36, 37,
        40, 41, 50, 51, 42, 43, 52, 53, 60, 61, 70, 71, 62, 63, 72, 73, 44, 45, 54, 55, 46, 47, 56, 57, 64, 65, 74, 75, 66, 67,
        76, 77, 8, 9, 18, 19, 28, 29, 38, 39, 48, 49, 58, 59, 68, 69, 78, 79, 80, 81, 82, 83, 84, 85, 86, 87, 88, 89,
    ],
}  # fmt: skip


@pytest.mark.parametrize("order", GOLDEN)
def test_a_small_picture_is_written_out(order):
    assert pixel_order(order, 5, 3).tolist() == GOLDEN[order]


@pytest.mark.parametrize("order", GOLDEN_WIDE)
def test_a_picture_beyond_a_square_is_written_out(order):
    assert pixel_order(order, 10, 9).tolist() == GOLDEN_WIDE[order]


def interleaved(x, y):
    """Return the bits of y and x in turn, those of x lowest."""
    return sum((x >> k & 1) << 2 * k | (y >> k & 1) << 2 * k + 1 for k in range(16))


def along_hilbert(x, y, side):
    """Return how far from the corner (0, 0) a pixel of a square lies on the curve that ends at (side - 1, 0)."""
    distance = 0
    while side > 1:
        side //= 2
        right, below = x >= side, y >= side
        distance += side * side * (3 if right and not below else 2 if right else 1 if below else 0)
        x, y = x - side * right, y - side * below
        if not below:  # the first quarter is mirrored at the main diagonal, the last at the other one
            x, y = (side - 1 - y, side - 1 - x) if right else (y, x)
    return distance


def in_tiles(x, y):
    """Return the place of a pixel: column of tiles, tile, row and column of squares, row, column."""
    return x // 64, y // 64, y % 64 // 8, x % 64 // 8, y % 8, x % 8


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("order", ["scanline", "tile", "morton", "hilbert"])
def test_every_order_is_that_of_its_key(order, size):
    width, height = size
    side = 1 << (max(size) - 1).bit_length()
    key = {
        "scanline": lambda x, y: (y, x),
        "tile": in_tiles,
        "morton": interleaved,
        "hilbert": lambda x, y: along_hilbert(x, y, side),
    }[order]
    pixels = [(x, y) for y in range(height) for x in range(width)]
    want = [y * width + x for x, y in sorted(pixels, key=lambda pixel: key(*pixel))]
    assert pixel_order(order, width, height).tolist() == want


def pcg64(seed, n):
    """Return n numbers of PCG64 (XSL RR 128/64, O'Neill 2014) in Python's integers, from the state that NumPy seeds."""
    mask = (1 << 128) - 1
    state = np.random.PCG64(seed).state["state"]
    now, numbers = state["state"], []
    for _ in range(n):
        now = (now * 0x2360ED051FC65DA44385DF649FCCF645 + state["inc"]) & mask
        folded, turn = (now >> 64) ^ (now & (1 << 64) - 1), now >> 122
        numbers.append((folded >> turn | folded << (64 - turn)) & (1 << 64) - 1)
    return numbers


@pytest.mark.parametrize("seed", [0, 1, 12345])
def test_the_random_order_sorts_pixels_by_the_upper_half_of_random_numbers(seed):
    numbers = pcg64(seed, 13 * 7)
    want = sorted(range(13 * 7), key=lambda pixel: (numbers[pixel] >> 32, pixel))
    assert pixel_order("random", 13, 7, seed).tolist() == want


def test_the_random_order_is_written_out():
    assert pixel_order("random", 4, 3, 0).tolist() == [11, 3, 2, 1, 8, 6, 0, 7, 4, 10, 5, 9]
    assert pixel_order("random", 4, 3, 1).tolist() == [9, 2, 4, 7, 5, 0, 11, 8, 10, 6, 3, 1]


def test_large_pictures_by_their_digest():
    """Orders of 1000 x 700 pixels as they were when this was written."""
    digests = {
        order: hashlib.sha256(pixel_order(order, 1000, 700, 5).astype("<u4").tobytes()).hexdigest()[:16]
        for order in ("tile", "morton", "hilbert", "random")
    }
    assert digests == {
        "tile": "4a1294a35e2ec85e",
        "morton": "b6c1e758a2c34a7a",
        "hilbert": "b01b98275740e826",
        "random": "673e4987d98e84e0",
    }
