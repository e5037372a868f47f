"""Metrics, and the networks that come with gs3."""

import numpy as np
import pytest

import gs3
from gs3 import metrics


def pictures():
    rng = np.random.default_rng(3)
    a = rng.uniform(0, 1, (40, 48, 3)).astype(np.float32)
    return a, (a + rng.normal(0, 0.05, a.shape)).clip(0, 1).astype(np.float32)


def test_metrics_are_what_they_are_defined_as():
    a, b = pictures()
    np.testing.assert_allclose(metrics.psnr(a, b), -10 * np.log10(((a - b).astype(np.float64) ** 2).mean()), rtol=1e-6)
    rounded = [np.floor(x * np.float32(255) + np.float32(0.5)).astype(np.uint8) for x in (a, b)]
    assert abs(metrics.psnr(*rounded) - metrics.psnr(a, b, eight_bit=True)) < 1e-4
    assert metrics.psnr(a, a) == np.inf and abs(metrics.ssim(a, a) - 1) < 1e-6 and metrics.flip(a, a) == 0
    assert 0.5 < metrics.ssim(a, b) < 1 and metrics.ssim(a, b) != metrics.ssim(a, b, zero_pad=True)
    error_map = metrics.flip_map(a, b)
    assert error_map.shape == (40, 48)
    np.testing.assert_allclose(error_map.mean(), metrics.flip(a, b), rtol=1e-5)
    # An error that stays costs nothing over time; one that alternates is flicker of its own size.
    darker = a * np.float32(0.5)
    assert metrics.tpsnr([a, a], [darker, darker]) == np.inf
    gray, light = np.full_like(a, 0.4), np.full_like(a, 0.5)
    np.testing.assert_allclose(metrics.flicker([gray] * 3, [gray, light, gray]), 0.05, rtol=1e-5)


def test_metrics_refuse_what_does_not_fit():
    a, b = pictures()
    with pytest.raises(gs3.InputError, match="expected 48x40 pixels, found 48x39"):
        metrics.psnr(a, b[:-1])
    with pytest.raises(gs3.InputError, match=r"test: expected shape \[H, W, 3\], found \[40, 48\]"):
        metrics.ssim(a, b[..., 0])
    with pytest.raises(gs3.InputError, match="reference: expected 2 frames, found 1"):
        metrics.tpsnr([a], [b, b])


@pytest.mark.parametrize("network", ["super_sample", "interpolate"])
def test_weights_are_arrays_and_an_onnx_file(tmp_path, network):
    arrays = gs3.weights(network, tier="fast")
    assert len(arrays) > 5
    for name, values in arrays.items():
        assert values.dtype == np.float32 and np.isfinite(values).all(), name
        assert values.ndim == (4 if name.endswith("weight") else 1), (name, values.shape)
    info = gs3.weights_info(network, tier="fast")
    assert (info["network"], info["tier"], info["scale"]) == (network, "fast", 4) and info["licence"]
    gs3.export_onnx(tmp_path / "a.onnx", network, tier="fast")
    data = (tmp_path / "a.onnx").read_bytes()
    for name, values in arrays.items():
        assert name.encode() in data and values.tobytes()[:64] in data, name


def test_networks_that_do_not_come_with_gs3_are_named(tmp_path):
    with pytest.raises(gs3.InputError, match="network: expected super_sample or interpolate, found \"denoise\""):
        gs3.weights("denoise")
    with pytest.raises(gs3.InputError, match="tier: expected one of fast, balanced, high"):
        gs3.weights(tier="tiny")
    with pytest.raises(gs3.InputError, match="3"):
        gs3.weights(scale=3)
    with pytest.raises(gs3.FileError, match="a.onnx"):
        gs3.export_onnx(tmp_path / "none" / "a.onnx", tier="fast")
