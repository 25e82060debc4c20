"""How near an image is to the truth, pixel by pixel: NMSE and SSIM."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from shared.physics.errors import InputError

SPAN_DB = 40.0
"""Dynamic range in which images are compared in dB."""
SSIM_SIGMA, SSIM_RADIUS, SSIM_K1, SSIM_K2 = 1.5, 5, 0.01, 0.03
"""Wang et al. 2004: a Gaussian of 1.5 pixels in a window of 11, and the constants against division by zero."""
SSIM_WINDOW = 2 * SSIM_RADIUS + 1


def nmse(estimate: NDArray[np.floating], truth: NDArray[np.floating]) -> float:
    """Normalised mean squared error sum (e - t)^2 / sum t^2: 0 is perfect, an empty estimate has 1.

    :raises InputError: different shapes, not finite, or an empty truth
    """
    x, y = _pair(estimate, truth)
    energy = float(np.sum(y**2))
    if energy == 0.0:
        raise InputError("truth", "an image of zeros", "an image with an echo, for a normalised error")
    return float(np.sum((x - y) ** 2)) / energy


def nmse_best_scaled(estimate: NDArray[np.floating], truth: NDArray[np.floating]) -> float:
    """The least NMSE over all factors on the estimate, 1 - (sum e t)^2 / (sum e^2 sum t^2), from 0 to 1.

    :raises InputError: different shapes, not finite, or an empty truth
    """
    x, y = _pair(estimate, truth)
    energy = float(np.sum(x**2))
    factor = float(np.sum(x * y)) / energy if energy > 0.0 else 0.0
    return nmse(factor * x, y)


def ssim(estimate: NDArray[np.floating], truth: NDArray[np.floating]) -> float:
    """Mean structural similarity of images from 0 to 1: 1 for identical ones.

        (2 m_x m_y + c_1) (2 s_xy + c_2) / ((m_x^2 + m_y^2 + c_1) (s_x^2 + s_y^2 + c_2)),   c_i = K_i^2

    with means, variances and covariance in Gaussian windows, averaged over the pixels whose window lies within the
    image. Wang, Bovik, Sheikh and Simoncelli, IEEE Trans. Image Process. 13(4), 2004. Where both images are empty it
    is 1 too, so that an empty image earns the truth's empty share.

    :raises InputError: different shapes, not finite, or smaller than the window of 11 pixels
    """
    x, y = _pair(estimate, truth)
    if x.ndim != 2 or min(x.shape) <= 2 * SSIM_RADIUS:
        raise InputError("ssim", f"images of shape {x.shape}", f"two dimensions of at least {2 * SSIM_RADIUS + 1}")

    def mean(image: NDArray[np.float64]) -> NDArray[np.float64]:
        return gaussian_filter(image, SSIM_SIGMA, radius=SSIM_RADIUS)

    mean_x, mean_y = mean(x), mean(y)
    variance = mean(x * x) - mean_x**2 + mean(y * y) - mean_y**2
    covariance = mean(x * y) - mean_x * mean_y
    c1, c2 = SSIM_K1**2, SSIM_K2**2
    likeness = (2.0 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1) * (2.0 * covariance + c2) / (variance + c2)
    inner = slice(SSIM_RADIUS, -SSIM_RADIUS)
    return float(likeness[inner, inner].mean())


def _pair(
    estimate: NDArray[np.floating], truth: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, y = np.asarray(estimate, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    if x.shape != y.shape or not x.size:
        raise InputError("images", f"shapes {x.shape} and {y.shape}", "two images of one shape")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError("images", "pixels that are not finite", "finite magnitudes")
    return x, y
