//! SqueezeNet v1.0 up to fire5 (Iandola et al. 2016), in the three parts between its poolings.

use gs3_neural::arrays::{Array, Arrays};
use gs3_neural::{
    Activation, Border, Conv2d, Graph, GraphBuilder, GraphError, Header, Op, Tensor, WeightError, Weights,
};

use crate::error::TrainError;

/// The image or the features that a part reads, and the features that it gives.
pub const INPUT: &str = "input";
pub const FEATURES: &str = "features";

/// Pixels of conv1's result, on the grid of half the image's size, that its graph gives before those that the network
/// has: the window of 7×7 lies between −4 and 2 instead of 0 and 6.
pub const CONV1_BEFORE: usize = 2;

/// And in all.
pub const CONV1_MORE: usize = 3;

/// Channels of conv1 and of fire4, which go into the parts after them.
pub const AFTER_CONV1: usize = 96;
const AFTER_FIRE4: usize = 256;

/// The parts as graphs, with their weights among `arrays`, named as in the published file.
///
/// # Errors
/// [`TrainError::Weights`] if a weight has another shape.
pub fn parts(arrays: &Arrays) -> Result<[(Graph, Weights); 3], TrainError> {
    let conv1 = arrays.get("conv1.weight").map(unshuffled).transpose()?;
    let mut all = arrays.clone();
    all.extend(conv1.map(|array| ("conv1.weight".to_owned(), array)));
    let graphs = [
        graph("conv1", |g| {
            let image = g.input(INPUT, 3, 2);
            let blocks = g.layer("blocks", Op::PixelUnshuffle { factor: 2 }, &[image]);
            g.conv("conv1", Conv2d::new(5, AFTER_CONV1).activation(Activation::Relu), &[blocks])
        })?,
        graph("fire2 to fire4", |g| {
            let x = g.input(INPUT, AFTER_CONV1, 1);
            let x = fire(g, "fire2", 16, 64, x);
            let x = fire(g, "fire3", 16, 64, x);
            fire(g, "fire4", 32, 128, x)
        })?,
        graph("fire5", |g| {
            let x = g.input(INPUT, AFTER_FIRE4, 1);
            fire(g, "fire5", 32, 128, x)
        })?,
    ];
    Ok(graphs.map(|graph| {
        let names: Vec<String> = graph.parameters().into_iter().map(|parameter| parameter.name).collect();
        let mine = all.iter().filter(|(name, _)| names.contains(name));
        let arrays = mine.map(|(name, array)| (name.clone(), array.clone())).collect();
        let header = Header::of(&graph, 1);
        (graph, Weights { header, arrays })
    }))
}

fn graph(name: &str, layers: impl FnOnce(&mut GraphBuilder) -> Tensor) -> Result<Graph, GraphError> {
    let mut g = GraphBuilder::new(name, 1, Border::Zero);
    let features = layers(&mut g);
    g.output(FEATURES, features);
    g.finish()
}

/// A fire module: few channels, from which 1×1 and 3×3 windows make many.
fn fire(g: &mut GraphBuilder, name: &str, squeezed: usize, expanded: usize, x: Tensor) -> Tensor {
    let conv = |kernel, outputs| Conv2d::new(kernel, outputs).activation(Activation::Relu);
    let x = g.conv(&format!("{name}.conv1x1_1"), conv(1, squeezed), &[x]);
    let one = g.conv(&format!("{name}.conv1x1_2"), conv(1, expanded), &[x]);
    let three = g.conv(&format!("{name}.conv3x3_2"), conv(3, expanded), &[x]);
    g.layer(&format!("{name}.expanded"), Op::Concat, &[one, three])
}

/// conv1 has windows of 7×7 at every second pixel. On an image with blocks of 2×2 pixels as channels, these are
/// windows of 4×4 at every place; with a row and a column of zeros, they are 5×5 about a centre.
fn unshuffled(conv1: &Array) -> Result<Array, WeightError> {
    let expected = [AFTER_CONV1, 3, 7, 7];
    let name = "conv1.weight";
    if conv1.shape() != expected {
        let actual = format!("{:?}", conv1.shape());
        return Err(WeightError::Shape { name: name.to_owned(), expected: expected.to_vec(), actual });
    }
    let mut values = vec![0.0; AFTER_CONV1 * 12 * 25];
    for (k, w) in conv1.values().iter().enumerate() {
        let (x, y, c, o) = (k % 7, k / 7 % 7, k / 49 % 3, k / 147);
        // Channel c·4 + i·2 + j of the blocks is pixel (2y + i, 2x + j) of channel c.
        let channel = 4 * c + 2 * (y % 2) + x % 2;
        values[((o * 12 + channel) * 5 + y / 2) * 5 + x / 2] = *w;
    }
    Array::new(name, &[AFTER_CONV1, 12, 5, 5], values)
}
