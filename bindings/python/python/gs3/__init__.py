"""3D Gaussian Splatting on any machine: rasterization in gsplat's shape, super sampling, frame interpolation.

>>> import gs3
>>> scene, path = gs3.demo(), gs3.demo_path().resized(640, 360)
>>> renderer = gs3.Renderer(scene, 640, 360)
>>> for frames in renderer.follow(path[:10]):
...     for frame in frames:  # f32 [360, 640, 3]
...         pass
"""

from . import metrics
from ._cameras import CameraPath, demo_path, load_cameras
from ._errors import Cancelled, DeviceError, FileError, Gs3Error, InputError, Unsupported
from ._gs3 import __version__
from ._networks import export_onnx, weights, weights_info
from ._png import save_png
from ._raster import rasterization
from ._reconstructor import NextFrame, Reconstructor
from ._renderer import Renderer, render_fn
from ._scene import Scene, demo


__all__ = [
    "CameraPath",
    "Cancelled",
    "DeviceError",
    "FileError",
    "Gs3Error",
    "InputError",
    "NextFrame",
    "Reconstructor",
    "Renderer",
    "Scene",
    "Unsupported",
    "__version__",
    "demo",
    "demo_path",
    "export_onnx",
    "load_cameras",
    "metrics",
    "rasterization",
    "render_fn",
    "save_png",
    "weights",
    "weights_info",
]
