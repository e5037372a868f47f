# %% [markdown]
# A tour of gs3: the built-in scene rasterized, along a path, and through the eyes of another renderer.
# Cells run in Jupyter, VS Code or as a script: `python show.py OUT.png`.

# %%
import struct
import sys
import zlib
from pathlib import Path

import numpy as np

import gs3

WIDTH, HEIGHT = 640, 360
scene = gs3.demo()  # or gs3.Scene.open("garden.ply")
path = gs3.demo_path().resized(WIDTH, HEIGHT)  # or gs3.load_cameras("cameras.json")
print(scene, path)

# %% [markdown]
# ## One image, as gsplat makes it
# With depth as the last channel, and what only Gaussians give for free: exact gradients, normals, median depth.

# %%
view, K = path.viewmats[40], path.Ks[40]
render, alphas, meta = scene.rasterization(view[None], K[None], WIDTH, HEIGHT, render_mode="RGB+ED")
native, depth, normals = render[0, ..., :3], render[0, ..., 3], meta["normals"][0]
print("depth", depth[alphas[0, ..., 0] > 0.5].min(), "to", depth.max())

# %% [markdown]
# ## A film
# A sixteenth of the pixels is rasterized. Each camera gives two frames: its own, and one between it and the last.

# %%
renderer = gs3.Renderer(scene, WIDTH, HEIGHT)
for frames in renderer.follow(path[32:41]):
    pass
film = frames[-1]
stages = ", ".join(f"{name} {time:.1f} ms" for name, time in renderer.stats["stage_ms"].items())
print(f"{gs3.metrics.psnr(native, film):.1f} dB against native; {stages}")

# %% [markdown]
# ## Another renderer
# Whatever makes colour and depth at low resolution can be reconstructed, with exact gradients all the better.

# %%
reconstructor = gs3.Reconstructor(WIDTH, HEIGHT, scale=4)
for view_k, K_k in zip(path.viewmats[25:41], path.Ks[25:41]):
    jitter = reconstructor.next_jitter(view_k, K_k)
    lr_K = reconstructor.lr_K(K_k, jitter)
    low, _, planes = scene.rasterization(view_k[None], lr_K[None], *reconstructor.lr_size, eps2d=0.3 / 4**2)
    shown = reconstructor.reconstruct(
        view_k,
        K_k,
        low[0],
        planes["median_depth"][0, ..., 0],
        color_dx=planes["color_dx"][0],
        color_dy=planes["color_dy"][0],
        jitter=jitter,
    )
print(f"reconstructed: {gs3.metrics.psnr(native, shown[-1]):.1f} dB")

# %% [markdown]
# ## A picture of it all
# Native and depth above, the film's frame and normals below.


# %%
def write_png(file: Path, image: np.ndarray) -> None:
    """Writes u8 [H, W, 3]."""
    height, width, _ = image.shape
    lines = np.concatenate([np.zeros((height, 1), np.uint8), image.reshape(height, -1)], 1)
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(lines.tobytes())) + chunk(b"IEND", b"")
    file.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


near = np.percentile(depth[depth > 0], 1)
shade = np.repeat((near / np.maximum(depth, near))[..., None], 3, 2) * (depth > 0)[..., None]
picture = np.block([[[native], [shade]], [[film], [0.5 - 0.5 * normals]]])
out = Path(sys.argv[1] if len(sys.argv) > 1 else "show.png")
write_png(out, (picture.clip(0, 1) * 255 + 0.5).astype(np.uint8))
print(out)
