"""Runs exported networks in ONNX Runtime and compares them with what the crate computed.

    pip install onnx onnxruntime safetensors
    python crates/gs3-neural/oracle/onnx_runtime.py FOLDER

`tests/onnx` writes FOLDER and runs this. It holds networks NAME.onnx and, for each, examples NAME.SIZE.safetensors with
arrays `input/IMAGE` and, of each computation HOW, `HOW/OUTPUT`, all `[1, channels, height, width]`. Every file must pass
ONNX's checker with shape inference, and every output stay within 1e-4 of the largest number of the expected one.
"""

import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from safetensors.numpy import load_file

TOLERANCE = 1e-4


def session(path):
    onnx.checker.check_model(str(path), full_check=True)
    model = onnx.shape_inference.infer_shapes(onnx.load(path), check_type=True, strict_mode=True, data_prop=True)
    for value in list(model.graph.input) + list(model.graph.output):
        assert len(value.type.tensor_type.shape.dim) == 4, f"{path.name}: {value.name} is no image"
    return onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])


def compare(name, run, example):
    """The largest error among the outputs, relative to the largest number expected; above TOLERANCE, said aloud."""
    arrays = load_file(example)
    inputs = {key.removeprefix("input/"): array for key, array in arrays.items() if key.startswith("input/")}
    names = [output.name for output in run.get_outputs()]
    results = dict(zip(names, run.run(names, inputs)))
    expected = {key: array for key, array in arrays.items() if not key.startswith("input/")}
    # Every output is expected by some computation, and nothing else is.
    assert {key.split("/", 1)[1] for key in expected} == set(names), f"{name}: gives {names}"
    worst = 0.0
    for key, array in expected.items():
        result = results[key.split("/", 1)[1]]
        assert result.shape == array.shape, f"{name} {key}: expected {array.shape}, found {result.shape}"
        error = float(np.abs(result - array).max() / np.abs(array).max())
        # Also when the error is not a number.
        if not error <= TOLERANCE:
            print(f"FAILED {name} {key}: relative error {error:.2e}", flush=True)
        worst = max(worst, error if error == error else np.inf)
    return worst


def main(folder):
    networks = sorted(folder.glob("*.onnx"))
    assert networks, f"{folder}: expected networks, found none"
    failed = 0
    for path in networks:
        run = session(path)
        examples = sorted(folder.glob(f"{path.stem}.*.safetensors"))
        assert examples, f"{path.stem}: expected examples, found none"
        errors = [compare(example.stem, run, example) for example in examples]
        print(f"{path.stem}: {len(examples)} sizes, largest relative error {max(errors):.1e}", flush=True)
        failed += sum(not error <= TOLERANCE for error in errors)
    print(f"{len(networks)} networks, onnx {onnx.__version__}, onnxruntime {onnxruntime.__version__}")
    return failed


if __name__ == "__main__":
    sys.exit(1 if main(Path(sys.argv[1])) else 0)
