//! NumPy's arrays to slices and images, and back.

use gs3::glam::{DAffine3, DMat3, DVec3};
use gs3::scene::{Camera, Image, Intrinsics};
use numpy::{Element, PyArray, PyArray1, PyArrayMethods, PyReadonlyArray, PyUntypedArrayMethods};
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::error;

/// The numbers of `array`, called `name`, which lie one after the other.
pub fn slice<'a, T: Element, D: numpy::ndarray::Dimension>(
    name: &str,
    array: &'a PyReadonlyArray<'_, T, D>,
) -> PyResult<&'a [T]> {
    array
        .as_slice()
        .map_err(|_| error::input(format_args!("{name}: expected a C-contiguous array, found gaps")))
}

/// Refuses an array of another shape.
pub fn check_shape(name: &str, expected: &[usize], actual: &[usize]) -> PyResult<()> {
    match expected == actual {
        true => Ok(()),
        false => Err(error::input(format_args!("{name}: expected shape {expected:?}, found {actual:?}"))),
    }
}

/// `values` as an array of `shape`, without a copy.
pub fn to_numpy<T: Element, const D: usize>(
    py: Python<'_>,
    values: Vec<T>,
    shape: [usize; D],
) -> PyResult<Bound<'_, PyArray<T, numpy::ndarray::Dim<[usize; D]>>>>
where
    [usize; D]: numpy::ndarray::IntoDimension<Dim = numpy::ndarray::Dim<[usize; D]>>,
    numpy::ndarray::Dim<[usize; D]>: numpy::ndarray::Dimension,
{
    PyArray1::from_vec(py, values).reshape(shape)
}

/// A frame's numbers, `[height, width, 3]`.
pub enum Pixels {
    Floats(Vec<f32>, [usize; 3]),
    Bytes(Vec<u8>, [usize; 3]),
}

impl Pixels {
    /// The pixels of `image`: unchanged f32, or bytes. All threads convert; call it without the interpreter's lock.
    pub fn of(image: &Image, as_bytes: bool) -> Self {
        let shape = [image.height(), image.width(), 3];
        if as_bytes { Self::Bytes(image.to_rgb8(), shape) } else { Self::Floats(image.to_rgb(), shape) }
    }

    /// As an array, without a copy.
    pub fn into_numpy(self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        Ok(match self {
            Self::Floats(values, shape) => to_numpy(py, values, shape)?.into_any().unbind(),
            Self::Bytes(values, shape) => to_numpy(py, values, shape)?.into_any().unbind(),
        })
    }
}

/// An image from `[height, width, 3]`.
pub fn image(name: &str, array: &PyReadonlyArray<'_, f32, numpy::Ix3>) -> PyResult<Image> {
    let &[height, width, _] = array.shape() else {
        return Err(error::input(format_args!("{name}: no image")));
    };
    check_shape(name, &[height, width, 3], array.shape())?;
    let pixels = slice(name, array)?.as_chunks::<3>().0;
    let pixels = pixels.par_iter().with_min_len(1 << 14).map(|[r, g, b]| [*r, *g, *b, 0.0]).collect();
    Image::from_pixels(width, height, pixels).ok_or_else(|| error::input(format_args!("{name}: no image")))
}

/// A camera from a world-to-camera matrix of OpenCV's axes and an intrinsic matrix, row after row.
pub fn camera(view: &[f64; 16], k: &[f64; 9], width: u32, height: u32) -> PyResult<Camera> {
    if view[12..] != [0.0, 0.0, 0.0, 1.0] {
        let found = &view[12..];
        return Err(error::input(format_args!(
            "viewmat: expected 0, 0, 0, 1 in its last row, found {found:?}"
        )));
    }
    let [fx, skew, cx, yx, fy, cy, last @ ..] = *k;
    if [skew, yx] != [0.0; 2] || last != [0.0, 0.0, 1.0] {
        return Err(error::input(format_args!(
            "K: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], a pinhole without skew, found {k:?}"
        )));
    }
    let row = |r: usize| DVec3::new(view[4 * r], view[4 * r + 1], view[4 * r + 2]);
    let matrix3 = DMat3::from_cols(row(0), row(1), row(2)).transpose();
    let translation = DVec3::new(view[3], view[7], view[11]);
    let intrinsics = Intrinsics { width, height, fx, fy, cx, cy };
    Camera::new(DAffine3 { matrix3, translation }, intrinsics).map_err(error::input)
}

/// The world-to-camera matrix of `camera`, row after row.
pub fn view_of(camera: &Camera) -> [f64; 16] {
    let DAffine3 { matrix3: m, translation: t } = camera.view_from_world();
    let row = |r: usize| [m.x_axis[r], m.y_axis[r], m.z_axis[r], t[r]];
    let mut view = [0.0; 16];
    for r in 0..3 {
        view[4 * r..4 * r + 4].copy_from_slice(&row(r));
    }
    view[15] = 1.0;
    view
}

/// The intrinsic matrix of `camera`, row after row.
pub fn k_of(camera: &Camera) -> [f64; 9] {
    let i = camera.intrinsics();
    [i.fx, 0.0, i.cx, 0.0, i.fy, i.cy, 0.0, 0.0, 1.0]
}

/// Matrices of `N` numbers, one after the other, of as many cameras.
pub type Matrices<'py> = PyReadonlyArray<'py, f64, numpy::Ix3>;

/// Cameras of one size from `[C, 4, 4]` and `[C, 3, 3]`.
pub fn cameras(views: &Matrices<'_>, ks: &Matrices<'_>, width: u32, height: u32) -> PyResult<Vec<Camera>> {
    let count = views.shape()[0];
    check_shape("viewmats", &[count, 4, 4], views.shape())?;
    check_shape("Ks", &[count, 3, 3], ks.shape())?;
    let (views, ks) = (slice("viewmats", views)?.as_chunks::<16>().0, slice("Ks", ks)?.as_chunks::<9>().0);
    views.iter().zip(ks).map(|(view, k)| camera(view, k, width, height)).collect()
}

/// One camera from `[4, 4]` and `[3, 3]`.
pub fn single_camera(
    view: &PyReadonlyArray<'_, f64, numpy::Ix2>,
    k: &PyReadonlyArray<'_, f64, numpy::Ix2>,
    [width, height]: [u32; 2],
) -> PyResult<Camera> {
    check_shape("viewmat", &[4, 4], view.shape())?;
    check_shape("K", &[3, 3], k.shape())?;
    let (view, k) = (slice("viewmat", view)?.as_chunks::<16>().0, slice("K", k)?.as_chunks::<9>().0);
    camera(&view[0], &k[0], width, height)
}
