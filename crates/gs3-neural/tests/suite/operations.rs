//! All operations; the tests of ONNX files share them.

use gs3_neural::Op;

/// Every operation that interpreters and derivatives know, with the inputs that it may have: "f" has one channel, "flow" two, a
/// name may come twice.
pub fn operations() -> Vec<(Op, Vec<&'static str>)> {
    let upsample = |factor| Op::Upsample { factor };
    vec![
        (Op::PixelShuffle { factor: 2 }, vec!["a"]),
        (Op::PixelShuffle { factor: 2 }, vec!["a", "b"]),
        (upsample(3), vec!["a"]),
        (upsample(2), vec!["a"]),
        (upsample(2), vec!["a", "f"]),
        (Op::MaxPool2, vec!["a"]),
        (Op::Concat, vec!["a", "f", "b"]),
        (Op::Concat, vec!["a", "a"]),
        (Op::Slice { first: 1, count: 2 }, vec!["a"]),
        (Op::Slice { first: 1, count: 3 }, vec!["a"]),
        (Op::Add, vec!["a", "b"]),
        (Op::Add, vec!["a", "a"]),
        (Op::Multiply, vec!["a", "b"]),
        (Op::Multiply, vec!["a", "f"]),
        (Op::Mix, vec!["a", "b", "f"]),
        (Op::Mix, vec!["a", "b", "b"]),
        (Op::ChannelMean, vec!["a"]),
        (Op::ChannelMax, vec!["a"]),
        (Op::Warp, vec!["a", "flow"]),
        (Op::Prelu, vec!["a"]),
        (Op::LayerNorm { epsilon: 1e-2 }, vec!["a"]),
        (Op::Scale { factor: -0.7 }, vec!["a"]),
        (Op::AveragePool { side: 5, stride: 3 }, vec!["a"]),
        (Op::AveragePool { side: 3, stride: 1 }, vec!["a"]),
    ]
}
