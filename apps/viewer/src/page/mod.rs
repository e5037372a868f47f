//! The viewer for a web page: what JavaScript calls. A worker drives it (`page/worker.js`), as the window drives it natively.

mod place;
mod settings;
#[cfg(target_arch = "wasm32")]
mod shell;

pub use place::{CameraPlace, CameraPlaceError};
pub use settings::{PageSettings, PageSettingsError};
#[cfg(target_arch = "wasm32")]
pub use shell::{PageViewer, thread_count};
#[cfg(all(feature = "threads", target_arch = "wasm32"))]
pub use wasm_bindgen_rayon::init_thread_pool;
