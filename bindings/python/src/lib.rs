//! The native half of the Python package `gs3`: conversions between NumPy's arrays and the library, which does the work
//! without the interpreter's lock. Arguments are brought to the types asked for here by `python/gs3`, which users see.

mod arrays;
mod cameras;
mod error;
mod metrics;
mod networks;
mod patience;
mod png_file;
mod raster;
mod reconstructor;
mod renderer;
mod scene;

use pyo3::prelude::*;

#[pymodule]
fn _gs3(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<scene::Scene>()?;
    module.add_class::<cameras::CameraPath>()?;
    module.add_class::<renderer::Renderer>()?;
    module.add_class::<reconstructor::Reconstructor>()?;
    metrics::add(module)?;
    png_file::add(module)?;
    networks::add(module)
}
