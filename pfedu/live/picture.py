"""Pixels to picture files."""

from io import BytesIO

import numpy as np
from PIL import Image


def quick_png(pixels):
    r"""PNG made fast, for a picture that is shown once.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (height, width, 4)

    Returns
    -------
    bytes

    Examples
    --------
    >>> from pfedu.live.picture import quick_png
    >>> quick_png(np.zeros((2, 2, 4), np.uint8))[:4]
    b'\x89PNG'
    """
    return _save(Image.fromarray(np.ascontiguousarray(pixels[..., :3])), compress_level=1)


def small_png(pixels, colors=64):
    r"""PNG made small, for a picture that travels: a palette of a few dozen colours.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (height, width, 4)
    colors : int
        Size of the palette.

    Returns
    -------
    bytes

    Examples
    --------
    >>> from pfedu.live.picture import small_png
    >>> small_png(np.zeros((2, 2, 4), np.uint8))[:4]
    b'\x89PNG'
    """
    image = Image.fromarray(np.ascontiguousarray(pixels[..., :3]))
    return _save(image.quantize(colors, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE), optimize=True)


def _save(image, **options):
    out = BytesIO()
    image.save(out, "png", **options)
    return out.getvalue()
