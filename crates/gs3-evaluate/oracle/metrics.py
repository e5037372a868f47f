"""Reference values for the metrics' tests: `metrics.json` and the images beside it.

    pip install numpy scikit-image flip-evaluator cvvdp pillow
    python crates/gs3-evaluate/oracle/metrics.py

The photographs are `chelsea` (Stefan van der Walt) and `coffee` (Rachel Michetti) of scikit-image, both CC0. The
metrics come from scikit-image (PSNR, SSIM), the `flip-evaluator` of its authors, the `cvvdp` of its authors, and, for
the temporal ones, from their definitions in f64 NumPy.
"""

import io
import json
from importlib.metadata import version
from pathlib import Path

import flip_evaluator
import numpy as np
from PIL import Image
from scipy.signal import convolve2d
from skimage import data
from skimage.metrics import mean_squared_error, peak_signal_noise_ratio, structural_similarity

OUT = Path(__file__).parent.parent / "tests" / "data"


def crop(image, top, left, height=160, width=200):
    return np.ascontiguousarray(image[top : top + height, left : left + width, :3])


def jpeg(image, quality):
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", quality=quality)
    return np.asarray(Image.open(buffer).convert("RGB"))


def down_up(image, factor):
    small = Image.fromarray(image).resize((image.shape[1] // factor, image.shape[0] // factor), Image.BOX)
    return np.asarray(small.resize((image.shape[1], image.shape[0]), Image.BICUBIC))


def as_float(image):
    return image.astype(np.float32) / np.float32(255)


def ssim_zero_pad(x, y):
    """SSIM as in the code published with 3D Gaussian Splatting: zero padding, mean over all pixels."""
    line = np.exp(-((np.arange(11) - 5.0) ** 2) / (2 * 1.5**2))
    line /= line.sum()
    window = np.outer(line, line)
    values = []
    for c in range(3):
        a, b = x[..., c].astype(np.float64), y[..., c].astype(np.float64)
        mean = lambda v: convolve2d(v, window, mode="same", boundary="fill")
        ma, mb = mean(a), mean(b)
        va, vb, cov = mean(a * a) - ma**2, mean(b * b) - mb**2, mean(a * b) - ma * mb
        values.append(((2 * ma * mb + 1e-4) * (2 * cov + 9e-4)) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4)))
    return float(np.mean(values))


def flip(reference, test):
    return float(flip_evaluator.evaluate(reference, test, "LDR", applyMagma=False)[1])


def flip_at(reference, test, points):
    map_ = flip_evaluator.evaluate(reference, test, "LDR", applyMagma=False)[0]
    return [{"x": x, "y": y, "flip": float(map_[y, x, 0])} for x, y in points]


def sequence(image, count):
    """Frame t is the 120×96 crop at (5t, 3t)."""
    return [image[3 * t : 3 * t + 96, 5 * t : 5 * t + 120] for t in range(count)]


def psnr(mse):
    return float(-10 * np.log10(mse))


def cvvdp_jod(reference, test, fps):
    import pycvvdp

    metric = pycvvdp.cvvdp(display_name="standard_4k", quiet=True)
    stack = lambda frames: np.stack(frames, axis=-1)
    if len(reference) == 1:
        return float(metric.predict(test[0], reference[0], dim_order="HWC")[0])
    return float(metric.predict(stack(test), stack(reference), dim_order="HWCF", frames_per_second=fps)[0])


def main():
    OUT.mkdir(parents=True, exist_ok=True)
    chelsea, coffee = crop(data.chelsea(), 60, 120), crop(data.coffee(), 120, 200)
    pairs = {"chelsea": (chelsea, jpeg(chelsea, 15)), "coffee": (coffee, down_up(coffee, 4))}
    images = {}
    for name, (reference, test) in pairs.items():
        Image.fromarray(reference).save(OUT / f"{name}.png", optimize=True)
        Image.fromarray(test).save(OUT / f"{name}_test.png", optimize=True)
        r, t = as_float(reference), as_float(test)
        # 0.9 of the test and 0.1 of the reference lies off the 8-bit grid.
        between = np.float32(0.9) * t + np.float32(0.1) * r
        quantised = np.floor(np.clip(between, 0, 1) * np.float32(255) + np.float32(0.5)) / 255.0
        images[name] = {
            "psnr": float(peak_signal_noise_ratio(r.astype(np.float64), t.astype(np.float64), data_range=1)),
            "psnr_between": psnr(mean_squared_error(r.astype(np.float64), between.astype(np.float64))),
            "psnr_between_8bit": psnr(mean_squared_error(r.astype(np.float64), quantised.astype(np.float64))),
            "ssim_crop": float(
                structural_similarity(
                    r.astype(np.float64), t.astype(np.float64), channel_axis=2, gaussian_weights=True, sigma=1.5,
                    use_sample_covariance=False, data_range=1,
                )
            ),
            "ssim_zero_pad": ssim_zero_pad(r, t),
            "flip": flip(r, t),
            "flip_at": flip_at(r, t, [(0, 0), (199, 159), (100, 80), (7, 90), (150, 3)]),
            "cvvdp_jod": cvvdp_jod([reference], [test], 0),
        }
    reference, test = (sequence(image, 4) for image in pairs["chelsea"])
    r, t = (np.stack([as_float(f).astype(np.float64) for f in s]) for s in (reference, test))
    error = t - r
    temporal = {
        "tpsnr": [psnr(mean_squared_error(np.diff(r, axis=0)[i], np.diff(t, axis=0)[i])) for i in range(3)],
        "flicker": [
            float(np.sqrt(np.mean(((error[i] - 2 * error[i + 1] + error[i + 2]) / 4) ** 2))) for i in range(2)
        ],
        "cvvdp_jod_30fps": cvvdp_jod(reference, test, 30),
    }
    versions = {name: version(name) for name in ["numpy", "scikit-image", "flip-evaluator", "cvvdp", "pillow"]}
    result = {"versions": versions, "images": images, "temporal": temporal}
    (OUT / "metrics.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
