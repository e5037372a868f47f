//! Warping as nodes of ONNX: a grid of places, made from the flow, and GridSample.
//!
//! GridSample takes places as −1 to 1 from edge to edge of the image (`align_corners` 0; from the first pixel's
//! centre to the last's, the other choice, divides by 0 where an image is one pixel wide). The centre of pixel p is
//! at (p + ½ − side/2) / (side/2); computed in this order, numbers stay small and hardly round.

use super::ops::Nodes;
use super::proto::{AttributeProto, FLOAT};

/// A direction of an image.
struct Axis {
    name: &'static str,
    /// Its channel of the flow.
    channel: i64,
    /// Its dimension of `[1, channels, height, width]`.
    dimension: i64,
    /// The other one of `[height, width]`.
    across: i64,
}

const X: Axis = Axis { name: "x", channel: 0, dimension: 3, across: 0 };
const Y: Axis = Axis { name: "y", channel: 1, dimension: 2, across: 1 };

/// Writes the nodes that move `image` by `flow`.
pub fn write(nodes: &mut Nodes<'_>, image: &str, flow: &str) {
    let shape = nodes.inner("shape", "Shape", &[flow], vec![]);
    let [x, y] = [X, Y].map(|axis| normalized_places(nodes, &axis, flow, &shape));
    let grid = nodes.inner("grid_chw", "Concat", &[&x, &y], vec![AttributeProto::int("axis", 1)]);
    let channels_last = vec![AttributeProto::ints("perm", &[0, 2, 3, 1])];
    let grid = nodes.inner("grid", "Transpose", &[&grid], channels_last);
    // Beyond the edges nothing changes; but far places may not fit the whole numbers that runtimes turn them into.
    let [first, last] =
        [("first_edge", -1.0), ("last_edge", 1.0)].map(|(part, edge)| nodes.constant(part, edge));
    let grid = nodes.inner("grid_inside", "Clip", &[&grid, &first, &last], vec![]);
    // The mode is the default, linear, unnamed: its name changed between opsets, and with it what readers know.
    let attributes =
        vec![AttributeProto::text("padding_mode", "border"), AttributeProto::int("align_corners", 0)];
    nodes.result("GridSample", &[image, &grid], attributes);
}

/// Where each pixel comes from along `axis`, `[1, 1, height, width]`. `shape` is the name of the flow's shape.
fn normalized_places(nodes: &mut Nodes<'_>, axis: &Axis, flow: &str, shape: &str) -> String {
    let part = |part: &str| format!("{}/{part}", axis.name);
    let to_float = || vec![AttributeProto::int("to", FLOAT.into())];

    let dimension = nodes.index(&part("dimension"), axis.dimension);
    let side = nodes.inner(&part("side"), "Gather", &[shape, &dimension], vec![]);
    let half = nodes.constant(&part("half"), 0.5);
    let half_side = nodes.inner(&part("side_f32"), "Cast", &[&side], to_float());
    let half_side = nodes.inner(&part("half_side"), "Mul", &[&half_side, &half], vec![]);

    let [zero, one] = [("zero", 0), ("one", 1)].map(|(name, value)| nodes.index(&part(name), value));
    let pixel = nodes.inner(&part("pixel"), "Range", &[&zero, &side, &one], vec![]);
    let pixel = nodes.inner(&part("pixel_f32"), "Cast", &[&pixel], to_float());
    let center = nodes.inner(&part("center"), "Add", &[&pixel, &half], vec![]);
    let center = nodes.inner(&part("from_middle"), "Sub", &[&center, &half_side], vec![]);
    let across = nodes.ints(&part("across"), &[axis.across]);
    let center = nodes.inner(&part("line"), "Unsqueeze", &[&center, &across], vec![]);

    let first = nodes.ints(&part("first"), &[axis.channel]);
    let end = nodes.ints(&part("end"), &[axis.channel + 1]);
    let channels = nodes.ints(&part("axes"), &[1]);
    let flow = nodes.inner(&part("flow"), "Slice", &[flow, &first, &end, &channels], vec![]);
    let place = nodes.inner(&part("place"), "Add", &[&flow, &center], vec![]);
    nodes.inner(&part("normalized"), "Div", &[&place, &half_side], vec![])
}
