//! Images that go into a network, by name.

use crate::error::RunError;
use crate::graph::Graph;
use crate::shape::Shape;

/// An image by name: channels last (`hwc`).
pub type Named<'a> = (&'a str, &'a [f32]);

/// The images for each layer of `graph` that is an input, none for the others.
pub(crate) fn inputs<'a>(
    graph: &Graph,
    shapes: &[Shape],
    images: &[Named<'a>],
) -> Result<Vec<Option<&'a [f32]>>, RunError> {
    let mut found = vec![None; graph.layers().len()];
    for (name, image) in images {
        let Some((tensor, _)) = graph.inputs().find(|(_, layer)| layer.name == *name) else {
            let expected: Vec<&str> = graph.inputs().map(|(_, layer)| layer.name.as_str()).collect();
            return Err(RunError::Unknown { name: (*name).to_owned(), expected: expected.join(", ") });
        };
        check_length(name, shapes[tensor.0], image.len())?;
        found[tensor.0] = Some(*image);
    }
    for (tensor, layer) in graph.inputs() {
        if found[tensor.0].is_none() {
            return Err(RunError::Missing { name: layer.name.clone(), expected: shapes[tensor.0] });
        }
    }
    Ok(found)
}

/// Whether `actual` numbers are an image of `shape`.
pub(crate) fn check_length(name: &str, shape: Shape, actual: usize) -> Result<(), RunError> {
    match shape.len() == actual {
        true => Ok(()),
        false => Err(RunError::Length { name: name.to_owned(), shape, expected: shape.len(), actual }),
    }
}
