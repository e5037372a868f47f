"""`gs3.rasterization` against gsplat's formulas, and its shapes and errors."""

import numpy as np
import pytest

import gs3
import reference
import scenes

WIDTH, HEIGHT = 72, 54
# Of both, where rounding does not decide whether a Gaussian is blended. Single precision knows a splat's centre to 2⁻¹⁸ px
# here, which moves the colour of the smallest, σ = 1 px, by some 1e-5.
COLOR, DEPTH = 1e-4, 1e-3


def check(made, expected, what, least=0.9):
    """Holds colour and depth, where alpha is above a half, against the reference's."""
    (render, alphas, _), (color, alpha, depth, unsure) = made, expected
    sure = ~unsure
    assert sure.mean() > least, f"{what}: rounding decides {unsure.mean():.1%} of the pixels"
    assert np.abs(render[0, ..., :3] - color)[sure].max() <= COLOR, what
    assert np.abs(alphas[0, ..., 0] - alpha)[sure].max() <= COLOR, what
    opaque = sure & (alpha > 0.5)
    assert opaque.mean() > 0.05, f"{what}: nothing to compare"
    wanted = (depth / np.maximum(alpha, 1e-10))[opaque]
    assert np.abs(render[0, ..., 3][opaque] / wanted - 1).max() <= DEPTH, what


@pytest.mark.parametrize("seed", range(20))
def test_twenty_scenes_are_those_of_the_formulas(seed):
    view, K = scenes.camera(WIDTH, HEIGHT, tilt=0.15 * seed, cx=2.5 * (seed % 3))
    sh_degree = None if seed % 5 == 4 else seed % 5
    is_antialiased = seed % 2 == 1
    g = scenes.random(seed, view, K, WIDTH, HEIGHT, sh_degree=sh_degree)
    background = np.float32([0.2, 0.5, 0.9])
    mode = "antialiased" if is_antialiased else "classic"
    made = gs3.rasterization(
        *g.arrays(), view[None], K[None], WIDTH, HEIGHT,
        sh_degree=sh_degree, backgrounds=background[None], render_mode="RGB+ED", rasterize_mode=mode,
    )
    expected = reference.rasterize(g, view, K, WIDTH, HEIGHT, antialiased=is_antialiased, background=background)
    check(made, expected, f"seed {seed}, degree {sh_degree}, {mode}")


@pytest.mark.parametrize("eps2d, near, far", [(0.0, 0.01, 1e10), (1.5, 0.01, 1e10), (0.3, 2.0, 4.0)])
def test_dilation_and_planes(eps2d, near, far):
    view, K = scenes.camera(WIDTH, HEIGHT, tilt=0.4)
    g = scenes.random(77, view, K, WIDTH, HEIGHT)
    made = gs3.rasterization(
        *g.arrays(), view[None], K[None], WIDTH, HEIGHT,
        eps2d=eps2d, near_plane=near, far_plane=far, render_mode="RGB+ED",
    )
    check(made, reference.rasterize(g, view, K, WIDTH, HEIGHT, eps2d=eps2d, near=near, far=far), f"{eps2d} {near} {far}")


def test_opaque_splats_are_capped_as_in_gsplat():
    """One opaque splat leaves a thousandth, two leave 1e-6, which is below what ends blending."""
    view, K = np.eye(4), np.array([[50.0, 0, 8], [0, 50, 8], [0, 0, 1]])
    means, quats = np.float32([[0, 0, 1], [0, 0, 2]]), np.float32([[1, 0, 0, 0]] * 2)
    arrays = means, quats, np.full((2, 3), 5, np.float32), np.ones(2, np.float32), np.float32([[1, 0, 0], [0, 1, 0]])
    render, alphas, _ = gs3.rasterization(*arrays, view[None], K[None], 16, 16)
    np.testing.assert_allclose(alphas[0, 8, 8], 0.999, atol=1e-6)
    np.testing.assert_allclose(render[0, 8, 8], [0.999, 0, 0], atol=1e-6)


def test_render_modes_agree_with_each_other():
    view, K = scenes.camera(WIDTH, HEIGHT)
    g = scenes.random(5, view, K, WIDTH, HEIGHT)
    made = {
        mode: gs3.rasterization(*g.arrays(), view[None], K[None], WIDTH, HEIGHT, render_mode=mode)
        for mode in ("RGB", "D", "ED", "RGB+D", "RGB+ED")
    }
    channels = {mode: render.shape for mode, (render, _, _) in made.items()}
    size = (1, HEIGHT, WIDTH)
    assert channels == {"RGB": (*size, 3), "D": (*size, 1), "ED": (*size, 1), "RGB+D": (*size, 4), "RGB+ED": (*size, 4)}
    alphas = made["RGB"][1]
    assert alphas.shape == (*size, 1) and alphas.dtype == np.float32
    for mode in ("RGB+D", "RGB+ED"):
        assert (made[mode][0][..., :3] == made["RGB"][0]).all()
    assert (made["RGB+D"][0][..., 3:] == made["D"][0]).all() and (made["RGB+ED"][0][..., 3:] == made["ED"][0]).all()
    np.testing.assert_allclose(made["ED"][0] * alphas, made["D"][0], rtol=1e-6)
    # A background is none of the depth.
    with_background = gs3.rasterization(
        *g.arrays(), view[None], K[None], WIDTH, HEIGHT, render_mode="D", backgrounds=[[1.0, 1, 1]]
    )
    assert (with_background[0] == made["D"][0]).all()


def test_cameras_of_a_batch_are_rendered_each():
    pairs = [scenes.camera(WIDTH, HEIGHT, tilt=0.05 * k, cx=k) for k in range(3)]
    g = scenes.random(9, *pairs[0], WIDTH, HEIGHT, sh_degree=2)
    backgrounds = np.float32([[0, 0, 0], [1, 1, 1], [0.5, 0, 1]])
    views, Ks = np.stack([view for view, _ in pairs]), np.stack([K for _, K in pairs])
    render, alphas, meta = gs3.rasterization(
        *g.arrays(), views, Ks, WIDTH, HEIGHT, sh_degree=2, backgrounds=backgrounds, render_mode="RGB+D"
    )
    assert render.shape == (3, HEIGHT, WIDTH, 4) and meta["n_cameras"] == 3 and meta["normals"].shape[0] == 3
    scene = gs3.Scene.from_arrays(*g.arrays()[:4], sh=g.colors)
    for k, (view, K) in enumerate(pairs):
        single = scene.rasterization(view[None], K[None], WIDTH, HEIGHT, backgrounds=backgrounds[k : k + 1], render_mode="RGB+D")
        assert (single[0][0] == render[k]).all() and (single[1][0] == alphas[k]).all()
        assert (single[2]["color_dx"][0] == meta["color_dx"][k]).all()


def test_lower_degrees_use_lower_bands():
    view, K = scenes.camera(WIDTH, HEIGHT)
    g = scenes.random(3, view, K, WIDTH, HEIGHT, sh_degree=3)
    made = gs3.rasterization(*g.arrays(), view[None], K[None], WIDTH, HEIGHT, sh_degree=1, render_mode="RGB+ED")
    g.sh_degree = 1
    check(made, reference.rasterize(g, view, K, WIDTH, HEIGHT), "degree 1 of 3")


def test_gradients_are_those_of_finite_differences():
    """Moving the principal point by h moves the samples by −h. Splats are smooth and far from all thresholds."""
    view, K = np.eye(4), np.array([[60.0, 0, 20], [0, 60, 16], [0, 0, 1]])
    means, quats = np.float32([[0, 0, 2], [0.1, 0.1, 2.5]]), np.float32([[1, 0.2, 0.1, 0], [1, 0, 0, 0.3]])
    scales, colors = np.float32([[0.4, 0.3, 0.2]] * 2), np.float32([[1, 0.5, 0.2], [0.1, 0.4, 0.9]])
    scene = gs3.Scene.from_arrays(means, quats, scales, np.float32([0.7, 0.8]), colors=colors)
    _, _, meta = scene.rasterization(view[None], K[None], 40, 32)
    h = 0.05
    for axis, name in ((0, "color_dx"), (1, "color_dy")):
        ahead, behind = K.copy(), K.copy()
        ahead[axis, 2] -= h
        behind[axis, 2] += h
        a, b = (scene.rasterization(view[None], k[None], 40, 32, gbuffer=False)[0] for k in (ahead, behind))
        inner = np.s_[:, 10:22, 14:26]
        # The third derivative of a Gaussian of σ ≥ 6 px moves the difference by h²/6 · 1.4/σ³ < 1e-5, rounding by 1e-5.
        np.testing.assert_allclose(meta[name][inner], ((a - b) / (2 * h))[inner], atol=5e-5)
        assert np.abs(meta[name][inner]).max() > 0.01


def test_normals_and_median_depth_of_a_wall():
    """A flat opaque splat that is turned shows its plane: depth by the ray, normal towards the camera."""
    angle = 0.6
    view, K = np.eye(4), np.array([[40.0, 0, 16], [0, 40, 16], [0, 0, 1]])
    quat = np.float32([[np.cos(angle / 2), 0, np.sin(angle / 2), 0]])
    arrays = np.float32([[0, 0, 3]]), quat, np.float32([[1, 1, 1e-4]]), np.float32([1]), np.float32([[1, 1, 1]])
    render, alphas, meta = gs3.rasterization(*arrays, view[None], K[None], 32, 32, render_mode="ED")
    normal = np.array([np.sin(angle), 0, np.cos(angle)])
    assert np.abs(render[alphas > 0.01] - 3).max() < 1e-5  # gsplat's depth is the centre's
    # RaDe-GS's depths are linear in the pixel: of rays within 0.04 of the centre's, what that leaves out is below 0.04².
    middle = meta["median_depth"][0, 16, 14:18, 0]
    rays = (np.arange(14, 18) + 0.5 - 16) / 40
    np.testing.assert_allclose(middle, 3 * normal[2] / (normal[2] + normal[0] * rays), rtol=2e-3)
    shown = meta["normals"][0, 16, 16] / np.linalg.norm(meta["normals"][0, 16, 16])
    np.testing.assert_allclose(shown, -normal, atol=1e-2)


class Tensor:
    """Nothing but DLPack, as tensors of other libraries."""

    def __init__(self, array):
        self.array, self.asked = array, 0

    def __dlpack__(self, **options):
        self.asked += 1
        return self.array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self.array.__dlpack_device__()


def test_tensors_go_in_and_out():
    view, K = scenes.camera(WIDTH, HEIGHT)
    g = scenes.random(1, view, K, WIDTH, HEIGHT)
    tensors = [Tensor(array) for array in (*g.arrays(), view[None], K[None])]
    render, _, _ = gs3.rasterization(*tensors, WIDTH, HEIGHT)
    assert all(tensor.asked for tensor in tensors)
    assert (render == gs3.rasterization(*g.arrays(), view[None], K[None], WIDTH, HEIGHT)[0]).all()
    assert (np.from_dlpack(render) == render).all()
    # Lists, other types and gaps are brought to f32.
    wide = np.zeros((len(g.means), 6))
    wide[:, ::2] = g.means
    again = gs3.rasterization(wide[:, ::2], g.quats.tolist(), *g.arrays()[2:], view[None], K[None], WIDTH, HEIGHT)
    assert (again[0] == render).all()


@pytest.mark.parametrize(
    "change, kind, message",
    [
        ({"means": np.zeros((4, 2))}, ValueError, r"means: expected shape \[N, 3\], found \[4, 2\]"),
        ({"quats": np.zeros((4, 3))}, ValueError, r"quats: expected shape \[150, 4\], found \[4, 3\]"),
        ({"opacities": np.zeros((150, 1))}, ValueError, r"opacities: expected shape \[150\], found \[150, 1\]"),
        ({"scales": np.array([["a"] * 3] * 150)}, ValueError, "scales: expected real numbers"),
        ({"colors": np.zeros((150, 5))}, NotImplementedError, r"colors: expected shape \[N, 3\]"),
        ({"colors": np.zeros((2, 150, 3))}, NotImplementedError, "state sh_degree"),
        ({"colors": np.full((150, 3), -1.0)}, ValueError, "colors: expected numbers of at least 0, found -1"),
        ({"sh_degree": 3, "colors": np.zeros((150, 9, 3))}, ValueError, "expected at least 16 coefficients"),
        ({"sh_degree": 5, "colors": np.zeros((150, 36, 3))}, ValueError, "sh_degree: expected 0 to 4, found 5"),
        ({"viewmats": np.eye(4)}, ValueError, r"viewmats: expected shape \[C, 4, 4\], found \[4, 4\]"),
        ({"viewmats": 2 * np.eye(4)[None]}, ValueError, "viewmat"),
        ({"Ks": np.zeros((2, 3, 3))}, ValueError, r"Ks: expected shape \[1, 3, 3\], found \[2, 3, 3\]"),
        ({"Ks": np.array([[[9.0, 1, 0], [0, 9, 0], [0, 0, 1]]])}, ValueError, "without skew"),
        ({"width": 0}, ValueError, "width: expected a whole number from 1 to 65535"),
        ({"near_plane": -1.0}, ValueError, "near plane: expected a positive"),
        ({"eps2d": -0.1}, ValueError, "dilation: expected"),
        ({"render_mode": "rgb"}, ValueError, "render_mode: expected RGB, D, ED"),
        ({"rasterize_mode": "mip"}, ValueError, "rasterize_mode: expected classic or antialiased"),
        ({"backgrounds": np.zeros(3)}, ValueError, r"backgrounds: expected shape \[1, 3\], found \[3\]"),
        ({"camera_model": "fisheye"}, NotImplementedError, "camera_model: expected 'pinhole'"),
        ({"radius_clip": 1.0}, NotImplementedError, "radius_clip: expected 0.0"),
        ({"covars": np.zeros((150, 3, 3))}, NotImplementedError, "covars: expected None"),
    ],
)
def test_errors_say_what_was_expected_and_found(change, kind, message):
    view, K = scenes.camera(WIDTH, HEIGHT)
    g = scenes.random(1, view, K, WIDTH, HEIGHT)
    names = ("means", "quats", "scales", "opacities", "colors")
    arguments = {**dict(zip(names, g.arrays())), "viewmats": view[None], "Ks": K[None], "width": WIDTH, "height": HEIGHT}
    with pytest.raises(kind, match=message) as caught:
        gs3.rasterization(**{**arguments, **change})
    assert isinstance(caught.value, gs3.Gs3Error)
