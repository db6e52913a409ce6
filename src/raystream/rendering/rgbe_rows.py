"""Decoding rows of Radiance images: flat, or run-length encoded in the old or new format."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import kernel

WHOLE, TRUNCATED, BAD_RUN, BAD_WIDTH = range(4)


@kernel
def unpack_rows(content, start, pixels):
    """Decode rows of pixels.

    Parameters
    ----------
    content : ndarray of shape (N,), uint8
    start : int
        Where the rows begin.
    pixels : ndarray of shape (H, W, 4), uint8
        Written.

    Returns
    -------
    int
        `WHOLE`, or an error code.
    """
    at, end = np.uint64(start), np.uint64(len(content))
    height, width = np.uint64(pixels.shape[0]), np.uint64(pixels.shape[1])
    one, two, three, four = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
    for row in range(height):
        if at + four > end:
            return TRUNCATED
        is_new = content[at] == 2 and content[at + one] == 2 and content[at + two] < 128
        if is_new and 8 <= width < 32768:
            high, low = np.uint64(content[at + two]), np.uint64(content[at + three])
            if (high << np.uint64(8)) + low != width:
                return BAD_WIDTH
            # New format: each channel separately; counts above 128 repeat a byte.
            at += four
            for channel in range(four):
                column = np.uint64(0)
                while column < width:
                    if at + two > end:
                        return TRUNCATED
                    count = np.uint64(content[at])
                    repeats = count > np.uint64(128)
                    if repeats:
                        count -= np.uint64(128)
                    at += one
                    if count == np.uint64(0) or column + count > width:
                        return BAD_RUN
                    if not repeats and at + count > end:
                        return TRUNCATED
                    for k in range(count):
                        pixels[row, column + k, channel] = content[at if repeats else at + k]
                    at += one if repeats else count
                    column += count
            continue
        # Flat or old format: pixels 1, 1, 1 repeat the previous one; several form one count.
        column, shift = np.uint64(0), np.uint64(0)
        while column < width:
            if at + four > end:
                return TRUNCATED
            is_run = content[at] == 1 and content[at + one] == 1 and content[at + two] == 1
            if is_run:
                if column == np.uint64(0) or shift > np.uint64(24):
                    return BAD_RUN
                count = np.uint64(content[at + three]) << shift
                shift += np.uint64(8)
                if column + count > width:
                    return BAD_RUN
                for k in range(count):
                    for channel in range(four):
                        pixels[row, column + k, channel] = pixels[row, column - one, channel]
                column += count
            else:
                for channel in range(four):
                    pixels[row, column, channel] = content[at + channel]
                column, shift = column + one, np.uint64(0)
            at += four
    return WHOLE
