//! Images that go into a network, by name.

use crate::error::RunError;
use crate::graph::{Graph, Shape, Tensor};

/// An image by name: channels last (`hwc`).
pub type Named<'a> = (&'a str, &'a [f32]);

/// Whether `images` are all inputs of `graph` and nothing else.
pub(crate) fn check(graph: &Graph, shapes: &[Shape], images: &[Named<'_>]) -> Result<(), RunError> {
    for (name, image) in images {
        check_length(name, shapes[input(graph, name)?.index()], image.len())?;
    }
    match graph.inputs().find(|(_, layer)| find(images, &layer.name).is_none()) {
        Some((tensor, layer)) => {
            Err(RunError::Missing { name: layer.name.clone(), expected: shapes[tensor.0] })
        }
        None => Ok(()),
    }
}

/// The input of that name.
pub(crate) fn input(graph: &Graph, name: &str) -> Result<Tensor, RunError> {
    graph.inputs().find(|(_, layer)| layer.name == name).map(|(tensor, _)| tensor).ok_or_else(|| {
        let expected: Vec<&str> = graph.inputs().map(|(_, layer)| layer.name.as_str()).collect();
        RunError::Unknown { name: name.to_owned(), expected: expected.join(", ") }
    })
}

/// The image of that name.
pub(crate) fn find<'a>(images: &[Named<'a>], name: &str) -> Option<&'a [f32]> {
    images.iter().find(|(n, _)| *n == name).map(|(_, image)| *image)
}

/// Whether `actual` numbers are an image of `shape`.
pub(crate) fn check_length(name: &str, shape: Shape, actual: usize) -> Result<(), RunError> {
    match shape.len() == actual {
        true => Ok(()),
        false => Err(RunError::Length { name: name.to_owned(), shape, expected: shape.len(), actual }),
    }
}
