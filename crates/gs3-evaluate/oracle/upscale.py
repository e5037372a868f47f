"""Reference values for the spatial baselines' tests: `upscale.json` and `coffee_lr.png`.

    pip install numpy pillow
    python crates/gs3-evaluate/oracle/upscale.py

Nearest, bilinear, bicubic and Lanczos come from Pillow in f32; FSR 1 from the transcription below of AMD's description
(names as there), pixel by pixel in f64. The Python Package Index has no implementation of FSR 1 (looked for in 2026; its
package `fsr` is something else), so this oracle is not an independent one: it finds slips of code, not of reading.
Values are kept at a seeded choice of pixels.
"""

import json
from math import floor, sqrt
from pathlib import Path

import numpy as np
from PIL import Image

OUT = Path(__file__).parent.parent / "tests" / "data"
SCALE = 4


def pillow(lr, kernel):
    height, width = lr.shape[:2]
    size = (width * SCALE, height * SCALE)
    planes = [Image.fromarray(lr[..., c].astype(np.float32)).resize(size, kernel) for c in range(3)]
    return np.stack([np.asarray(p) for p in planes], axis=-1).astype(np.float64)


def saturate(x):
    return min(max(x, 0.0), 1.0)


def easu(lr):
    height, width = lr.shape[:2]
    at = lambda x, y: lr[min(max(y, 0), height - 1), min(max(x, 0), width - 1)]
    out = np.zeros((height * SCALE, width * SCALE, 3))
    for oy in range(height * SCALE):
        for ox in range(width * SCALE):
            px, py = (ox + 0.5) / SCALE - 0.5, (oy + 0.5) / SCALE - 0.5
            fx, fy = floor(px), floor(py)
            px, py = px - fx, py - fy
            tap = lambda x, y: at(fx + x, fy + y)
            luma = lambda x, y: tap(x, y)[2] * 0.5 + (tap(x, y)[0] * 0.5 + tap(x, y)[1])
            direction, length = [0.0, 0.0], 0.0
            for x, y, w in [(0, 0, (1 - px) * (1 - py)), (1, 0, px * (1 - py)), (0, 1, (1 - px) * py), (1, 1, px * py)]:
                la, lb, lc, ld, le = luma(x, y - 1), luma(x - 1, y), luma(x, y), luma(x + 1, y), luma(x, y + 1)
                for axis, (low, high) in enumerate([(lb, ld), (la, le)]):
                    steepest = max(abs(high - lc), abs(lc - low))
                    direction[axis] += (high - low) * w
                    share = saturate(abs(high - low) / steepest) if steepest > 0 else 0.0
                    length += share * share * w
            norm2 = direction[0] ** 2 + direction[1] ** 2
            if norm2 < 1 / 32768:
                direction[0] = 1.0
            else:
                direction = [d / sqrt(norm2) for d in direction]
            length = (length * 0.5) ** 2
            stretch = (direction[0] ** 2 + direction[1] ** 2) / max(abs(direction[0]), abs(direction[1]))
            len2 = (1 + (stretch - 1) * length, 1 - 0.5 * length)
            lob = 0.5 + ((1 / 4 - 0.04) - 0.5) * length
            clp = 1 / lob
            colour, weight = np.zeros(3), 0.0
            for y in range(-1, 3):
                for x in range(-1, 3):
                    if x in (-1, 2) and y in (-1, 2):
                        continue
                    dx, dy = x - px, y - py
                    vx = (dx * direction[0] + dy * direction[1]) * len2[0]
                    vy = (dx * -direction[1] + dy * direction[0]) * len2[1]
                    d2 = min(vx * vx + vy * vy, clp)
                    wb = (2 / 5 * d2 - 1) ** 2
                    wa = (lob * d2 - 1) ** 2
                    w = (25 / 16 * wb - (25 / 16 - 1)) * wa
                    colour += tap(x, y) * w
                    weight += w
            near = np.stack([tap(0, 0), tap(1, 0), tap(0, 1), tap(1, 1)])
            out[oy, ox] = np.clip(colour / weight, near.min(axis=0), near.max(axis=0))
    return out


def rcas(image, stops):
    p = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="edge")
    b, d, f, h, e = p[:-2, 1:-1], p[1:-1, :-2], p[1:-1, 2:], p[2:, 1:-1], image
    mn4, mx4 = np.minimum(np.minimum(b, d), np.minimum(f, h)), np.maximum(np.maximum(b, d), np.maximum(f, h))
    # A black or white ring divides 0 by 0; `max` of a shader, like `fmax`, then takes the other operand.
    with np.errstate(invalid="ignore"):
        hit_min = mn4 / (4 * mx4)
        hit_max = (1 - mx4) / (4 * mn4 - 4)
    lobe = np.fmax.reduce(np.fmax(-hit_min, hit_max), axis=-1, keepdims=True)
    lobe = np.maximum(-(0.25 - 1 / 16), np.minimum(lobe, 0)) * 2.0**-stops
    return (lobe * (b + d + f + h) + e) / (4 * lobe + 1)


def main():
    small = Image.open(OUT / "coffee.png").resize((50, 40), Image.BOX)
    small.save(OUT / "coffee_lr.png", optimize=True)
    lr = np.asarray(small).astype(np.float64) / 255
    edges = easu(lr)
    images = {
        "nearest": pillow(lr, Image.NEAREST),
        "bilinear": pillow(lr, Image.BILINEAR),
        "bicubic": pillow(lr, Image.BICUBIC),
        "lanczos": pillow(lr, Image.LANCZOS),
        "fsr1": rcas(edges, 0.2),
    }
    rng = np.random.default_rng(1)
    # Pillow renormalises where kernels leave the image; border pixels are left out.
    points = sorted({(int(rng.integers(12, 188)), int(rng.integers(12, 148))) for _ in range(60)})
    result = {
        name: [{"x": x, "y": y, "rgb": [round(float(v), 7) for v in image[y, x]]} for x, y in points]
        for name, image in images.items()
    }
    # FSR 1 repeats the border: its corners count, too.
    result["fsr1"] += [
        {"x": x, "y": y, "rgb": [float(v) for v in images["fsr1"][y, x]]} for x, y in [(0, 0), (199, 159), (199, 0)]
    ]
    (OUT / "upscale.json").write_text(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
