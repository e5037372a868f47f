//! Quality metrics: pure functions on images (RGB; the fourth channel is never read) and on sequences of them.
//!
//! All metrics judge what a display would show: values are clamped to `[0, 1]` first, NaN counts as 0 (as in
//! [`Image::to_rgb8`]). `reference` is the ground truth, `test` what is judged. Results do not depend on the number of
//! threads: every sum is taken over fixed bands of rows and added up in their order.

pub mod blocks;
pub mod edges;
mod error;
pub mod flip;
mod mean_square;
mod planes;
pub mod psnr;
pub mod ssim;
pub mod temporal;
pub mod video;
pub mod warping;

pub use blocks::{block_rmse, block_rmse_p99};
pub use edges::{DepthEdges, edge_psnr};
pub use error::MetricError;
pub use flip::{flip, flip_map};
pub use mean_square::Quantisation;
pub use psnr::{psnr, psnr_from_mse};
pub use ssim::{SsimBorder, ssim};
pub use temporal::{flicker, tpsnr};
pub use video::{Viewing, color_video_vdp};
pub use warping::{WarpFrame, warping_error};

use gs3_scene::Image;

/// Rows per band, the unit of work: small enough to balance any number of threads, large enough that the ten extra rows
/// an 11×11 window needs stay a small share. Fixed, so that sums do not depend on the number of threads.
const BAND_ROWS: usize = 40;

/// Checks that `image`, called `what` in the error, has the size of `reference`.
fn same_size(reference: &Image, what: &'static str, image: &Image) -> Result<(), MetricError> {
    let (expected, actual) = (reference.size(), image.size());
    if expected == actual { Ok(()) } else { Err(MetricError::Size { what, expected, actual }) }
}

/// The value in `[0, 1]` that a display would show.
#[inline(always)]
#[expect(clippy::manual_clamp, reason = "`max` first maps NaN to 0; `clamp` would keep it")]
fn displayed(value: f32) -> f32 {
    value.max(0.0).min(1.0)
}
