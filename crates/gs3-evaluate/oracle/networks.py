"""Reference values for the published networks' tests: `networks.json`.

    pip install numpy pillow safetensors torch
    python crates/gs3-evaluate/oracle/networks.py WEIGHTS_FOLDER

The networks in PyTorch from their published weights, RT4KSR in its training form, on `coffee_lr.png`.
"""

import json
import sys
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image
from safetensors.torch import load_file

OUT = Path(__file__).parent.parent / "tests" / "data"


def span(w, x):
    conv = lambda name, x: F.conv2d(x, w[name + ".weight"], w[name + ".bias"], padding=w[name + ".weight"].shape[-1] // 2)
    x = (x - torch.tensor([0.4488, 0.4371, 0.4040]).view(1, 3, 1, 1)) * 255
    first = conv("conv_1.eval_conv", x)
    x, outs = first, []
    for i in range(1, 7):
        o1 = F.silu(conv(f"block_{i}.c1_r.eval_conv", x))
        o3 = conv(f"block_{i}.c3_r.eval_conv", F.silu(conv(f"block_{i}.c2_r.eval_conv", o1)))
        x = (o3 + x) * (torch.sigmoid(o3) - 0.5)
        outs.append(x)
    x = torch.cat([first, conv("conv_2.eval_conv", x), outs[0], o1], 1)
    return F.pixel_shuffle(conv("upsampler.0", conv("conv_cat", x)), 4)


def rt4ksr(w, x):
    get = lambda name: (w[f"module.{name}.weight"], w[f"module.{name}.bias"])

    def norm(name, x):
        weight, bias = get(name)
        return F.layer_norm(x.permute(0, 2, 3, 1), (24,), weight, bias, 1e-6).permute(0, 3, 1, 2)

    def rep(name, x):
        wide = F.conv2d(x, *get(name + ".expand_conv"))
        bias = get(name + ".expand_conv")[1].view(1, -1, 1, 1)
        padded = F.pad(wide - bias, (1, 1, 1, 1)) + bias
        return F.conv2d(F.conv2d(padded, *get(name + ".fea_conv")) + wide, *get(name + ".reduce_conv")) + x

    x = F.conv2d(F.pixel_unshuffle(x, 2), *get("head.0"), padding=1)
    for i in range(4):
        x = F.gelu(rep(f"body.{i}.conv1", norm(f"body.{i}.norm", x)))
    x = rep("tail.1", norm("tail.0", x))
    return F.pixel_shuffle(F.conv2d(x, *get("upsample.0"), padding=1), 4)


def safmn(w, x):
    conv = lambda name, x, **k: F.conv2d(x, w[name + ".weight"], padding=w[name + ".weight"].shape[-1] // 2, **k)
    x = first = conv("to_feat", x)
    for i in range(2):
        a, b = conv(f"feats.{i}.conv1.proj", x).chunk(2, 1)
        pooled = F.adaptive_max_pool2d(a, (x.shape[2] // 8, x.shape[3] // 8))
        wide = F.interpolate(conv(f"feats.{i}.conv1.dwconv", pooled, groups=16), size=x.shape[2:], mode="bilinear")
        x = conv(f"feats.{i}.conv1.out", F.gelu(torch.cat([b, F.gelu(wide) * a], 1)))
        x = conv(f"feats.{i}.conv2.conv.2", F.gelu(conv(f"feats.{i}.conv2.conv.0", x)))
    return F.pixel_shuffle(conv("to_img.0", x + first), 4)


def main():
    folder = Path(sys.argv[1])
    lr = np.asarray(Image.open(OUT / "coffee_lr.png")).astype(np.float32) / 255
    x = torch.from_numpy(lr).permute(2, 0, 1)[None]
    with torch.no_grad():
        weights = load_file(folder / "rt4ksr_x2.safetensors")
        twice = rt4ksr(weights, rt4ksr(weights, x).clamp(0, 1)).clamp(0, 1)
        images = {"span": span(load_file(folder / "span28_x4.safetensors"), x), "rt4ksr": twice}
        images["safmn"] = safmn(load_file(folder / "safmnpp_light_x4.safetensors"), x)
    rng = np.random.default_rng(2)
    points = [(int(rng.integers(200)), int(rng.integers(160))) for _ in range(40)] + [(0, 0), (199, 159)]
    result = {
        name: [{"x": px, "y": py, "rgb": [float(v) for v in image[0, :, py, px]]} for px, py in points]
        for name, image in images.items()
    }
    (OUT / "networks.json").write_text(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
