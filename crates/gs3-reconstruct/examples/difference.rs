//! What exact derivatives are worth to a renderer of any kind: PSNR against the native render of frames that
//! [`Reconstructor`] makes with exact derivatives, with differences of colours within surfaces, and with plain central
//! differences. ×4 to 1280×720, the rendered frames and those between of the first FRAMES frames after 8.
//!
//! `cargo run --release -p gs3-reconstruct --example difference -- (demo | SCENE PATH) [FRAMES]`

use std::path::Path;
use std::sync::Arc;

use gs3_raster::{Culling, Outputs, RasterSettings, Rasterizer, matched_dilation};
use gs3_reconstruct::{GBufferView, PlanesView, Reconstructor, ReconstructorSettings};
use gs3_scene::{Camera, GBuffer, Image, Planes, capture, demo, format};
use gs3_test_support::psnr_shown;

const SCALE: u32 = 4;

/// Frames that fill the history before the first that counts.
const WARM_UP: usize = 8;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

#[derive(Clone, Copy)]
enum Derivatives {
    Exact,
    WithinSurfaces,
    Central,
}

/// Central differences of `planes` along x and y, one-sided at the borders as if colours went on flat.
fn central(planes: &Planes<3>) -> [Planes<3>; 2] {
    let (width, height) = (planes.width(), planes.height());
    let mut out = [Planes::<3>::new(width, height), Planes::<3>::new(width, height)];
    for k in 0..3 * width * height {
        let (c, y, x) = (k / (width * height), k / width % height, k % width);
        let [left, right] = [x.saturating_sub(1), (x + 1).min(width - 1)].map(|x| planes.row(c, y)[x]);
        let [above, below] = [y.saturating_sub(1), (y + 1).min(height - 1)].map(|y| planes.row(c, y)[x]);
        out[0].data_mut()[k] = 0.5 * (right - left);
        out[1].data_mut()[k] = 0.5 * (below - above);
    }
    out
}

/// Mean PSNR of rendered frames and of those between.
fn quality(
    rasterizer: &mut Rasterizer,
    cameras: &[Camera],
    natives: &[Image],
    derivatives: Derivatives,
) -> Outcome<f64> {
    let settings = ReconstructorSettings { scale: SCALE, in_between: 0, ..Default::default() };
    let mut reconstructor = Reconstructor::new(settings)?;
    let (mut gbuffer, mut sum) = (GBuffer::default(), 0.0);
    for (k, camera) in cameras.iter().enumerate() {
        let jitter = reconstructor.next_jitter(camera);
        let settings = RasterSettings {
            dilation: matched_dilation(SCALE),
            jitter,
            ..RasterSettings::new(Outputs::GBuffer)
        };
        rasterizer.rasterize(&camera.low_resolution(SCALE), &settings, &mut gbuffer)?;
        let differences = central(&gbuffer.color);
        let exact = GBufferView::of(&gbuffer)?;
        let gradients = match derivatives {
            Derivatives::Exact => exact.gradients,
            Derivatives::WithinSurfaces => None,
            Derivatives::Central => Some(differences.each_ref().map(PlanesView::from)),
        };
        let shown = reconstructor.reconstruct(camera, &GBufferView { gradients, ..exact })?;
        if k >= WARM_UP {
            sum += psnr_shown(shown.current, &natives[k - WARM_UP]);
        }
    }
    Ok(sum / natives.len() as f64)
}

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let usage = "expected: (demo | SCENE PATH) [FRAMES]";
    let scene = arguments.first().ok_or(usage)?;
    let (scene, path, rest) = if scene == "demo" {
        (demo::scene()?, demo::path(), &arguments[1..])
    } else {
        let path = arguments.get(1).ok_or(usage)?;
        let scene = format::load(scene, &format::LoadOptions::default(), &|_| {})?;
        (scene, capture::load(Path::new(path))?, &arguments[2..])
    };
    let frames: usize = rest.first().map_or(Ok(16), |frames| frames.parse())?;
    let path = path.resized(1280, 720)?;
    let cameras = path.cameras().get(..WARM_UP + frames).ok_or("the path has fewer frames")?;
    let mut rasterizer = Rasterizer::new(Arc::new(scene), Culling::default());
    let mut natives = Vec::new();
    for camera in &cameras[WARM_UP..] {
        let mut native = Image::default();
        rasterizer.rasterize_image(camera, &RasterSettings::new(Outputs::Color), &mut native)?;
        natives.push(native);
    }
    for (name, derivatives) in [
        ("exact", Derivatives::Exact),
        ("differences within surfaces", Derivatives::WithinSurfaces),
        ("central differences", Derivatives::Central),
    ] {
        println!("{name:<28} {:.2} dB", quality(&mut rasterizer, cameras, &natives, derivatives)?);
    }
    Ok(())
}
