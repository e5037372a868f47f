//! Renders against captured images of a scene that was trained on them.
//!
//! Every camera of the capture names its photo. Renders and photos are compared at 8 bits, as if saved to files. Each
//! photo is compared twice: on its own, without any history, and at the end of a short path to it (`approach`), as
//! seen by a user who moves through the scene. Nothing is carried from one photo to the next. Photos of a lens that
//! is no pinhole are undistorted first, and only the part with content everywhere is compared. A photo with a file
//! larger or smaller than its camera's image is compared at the file's size, and the camera is scaled.

mod approach;
mod error;
mod file;
mod results;
mod undistort;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use gs3::Culling;
use gs3_raster::Rasterizer;
use gs3_scene::{Camera, CameraError, CameraPath, Image, Intrinsics, Scene, Size};

pub use error::PhotoError;
pub use results::{PhotoFacts, PhotoImage, PhotoMethodScore, PhotoResults, PhotoRow, PhotoScore};

use crate::digest;
use crate::methods::{Interpolation, Method, MethodSettings, MethodSpec, build, check_weights};
use crate::metrics::flip::DEFAULT_PIXELS_PER_DEGREE;
use crate::metrics::{Quantisation, SsimBorder, flip, psnr, ssim};
use crate::protocol::{Cache, EvaluateError, Event, Failure, PSNR_CAP, crop, part_of};
use approach::{Depth, approach};

use undistort::Undistortion;

/// The methods compared with photos where none are named.
pub const DEFAULT_PHOTO_METHODS: &str = "native,bicubic,hermite,spline,history,overscan,bicubic@kerbl";

/// Extensions that captures leave out.
const EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

/// Photos shown in reports.
const SHOWN: usize = 4;

/// Cameras that methods may fit to.
const TRAINING_PHOTOS: usize = 4;

/// What to compare with photos.
#[derive(Clone, Debug)]
pub struct PhotoProtocol {
    /// The scene.
    pub scene: Arc<Scene>,
    /// Its name in reports.
    pub scene_name: String,
    /// Cameras with the names of their photos.
    pub capture: CameraPath,
    /// Where the cameras came from.
    pub capture_path: PathBuf,
    /// Where the photos are; none: where captures keep them, in the folder of the capture or in `images` beside it.
    pub images: Option<PathBuf>,
    /// Every how manieth photo is judged, from the first on in the order of the capture, those without a file left out:
    /// 1 for all, 8 for the photos that are left out of training by common convention.
    pub every: usize,
    /// HR over LR size.
    pub scale: u32,
    /// Methods to compare; native rendering is always among them.
    pub methods: Vec<MethodSpec>,
    /// Which tiles a splat is assigned to.
    pub culling: Culling,
    /// Background, display-encoded RGB, finite.
    pub background: [f32; 3],
    /// Folder with weights, as [`MethodSettings::weights`].
    pub weights: Option<PathBuf>,
    /// The command that was given, for the report.
    pub command: String,
}

/// A photo to be judged against.
struct Photo {
    name: String,
    file: PathBuf,
    camera: Camera,
    /// What makes the photo the camera's image, where its lens is no pinhole.
    undistortion: Option<Undistortion>,
    /// The cameras of the frames before it.
    way: Vec<Camera>,
}

/// The photos of a capture that are there, in its order, as indices of their cameras; and the names of those that are
/// not.
struct Found {
    there: Vec<(usize, PathBuf)>,
    missing: Vec<String>,
}

impl PhotoProtocol {
    /// Runs the comparison; `folder` keeps what is finished.
    ///
    /// # Errors
    /// [`PhotoError`] if all photos are missing, if one cannot be read or does not fit its camera, if the methods or the
    /// scale make no sense, or if a file cannot be written. Some photos that are missing, and a method that fails, are
    /// listed in the results.
    pub fn run(&self, folder: &Path, watch: &mut dyn FnMut(Event<'_>)) -> Result<PhotoResults, PhotoError> {
        let methods = MethodSpec::with_native(&self.methods);
        if let Some(method) = methods.iter().find(|m| m.interpolation != Interpolation::None) {
            return Err(PhotoError::Interpolates { method: *method });
        }
        if !(2..=gs3_reconstruct::MAX_SCALE).contains(&self.scale) {
            return Err(EvaluateError::Scale { actual: self.scale }.into());
        }
        check_weights(&methods, self.scale, self.weights.as_deref()).map_err(EvaluateError::from)?;
        let every = self.every.max(1);
        let Found { there, missing } = self.find_all()?;
        if !missing.is_empty() {
            watch(Event::PhotosMissing { names: &missing });
        }
        let mut rasterizer = Rasterizer::new(Arc::clone(&self.scene), self.culling);
        let photos = (there.iter().step_by(every))
            .map(|(index, file)| self.photo(*index, file, methods.len() > 1, &mut rasterizer))
            .collect::<Result<Vec<_>, _>>()?;
        let cache = Cache::new(folder, &self.key(&photos))?;
        let settings = MethodSettings {
            scene: Arc::clone(&self.scene),
            scale: self.scale,
            culling: self.culling,
            background: self.background,
            training: self.training(&there, every)?,
            weights: self.weights.clone(),
        };
        let (mut scores, mut failures) = (Vec::new(), Vec::new());
        for spec in methods {
            let part = part_of(spec, self.scale, self.weights.as_deref())?;
            if let Some(score) = cache.load(&part)? {
                watch(Event::Resumed { method: spec });
                scores.push((spec, score));
                continue;
            }
            let mut progress = |done| watch(Event::Method { method: spec, done, total: photos.len() });
            let judged =
                build(spec, &settings).map_err(|e| EvaluateError::from(e).into()).and_then(|mut method| {
                    self.judge(method.as_mut(), spec.spatial.has_history(), &photos, &mut progress)
                });
            match judged {
                Ok(score) => scores.push((spec, cache.store(&part, score)?)),
                Err(PhotoError::Evaluate(error)) => {
                    let failure = Failure::of(spec, &error);
                    watch(Event::Failed { failure: &failure });
                    failures.push(failure);
                }
                Err(error) => return Err(error),
            }
        }
        Ok(PhotoResults::new(self, photos.len(), missing, scores, failures))
    }

    /// All photos of the capture.
    fn find_all(&self) -> Result<Found, PhotoError> {
        let mut found = Found { there: Vec::new(), missing: Vec::new() };
        let mut first_error = None;
        for index in 0..self.capture.cameras().len() {
            let name = self.capture.name(index).ok_or(PhotoError::Unnamed { camera: index })?;
            match self.find(name) {
                Ok(file) => found.there.push((index, file)),
                Err(error) => {
                    found.missing.push(name.to_owned());
                    first_error = first_error.or(Some(error));
                }
            }
        }
        match first_error {
            Some(error) if found.there.is_empty() => Err(error),
            _ => Ok(found),
        }
    }

    /// The photo of camera `index` in `file`, with its camera at the photo's size; for LR methods both end where the last
    /// whole LR pixel does, and a way leads to them.
    fn photo(
        &self,
        index: usize,
        file: &Path,
        is_low_resolution: bool,
        rasterizer: &mut Rasterizer,
    ) -> Result<Photo, PhotoError> {
        // `find_all` has found it by this name.
        let name = self.capture.name(index).unwrap_or_default().to_owned();
        let size = file::size(file)?;
        let camera = &self.capture.cameras()[index];
        let camera = following(camera, size).ok_or_else(|| PhotoError::Shape {
            path: file.to_owned(),
            expected: camera.size(),
            actual: size,
        })??;
        let undistortion = match self.capture.lens(index) {
            None => None,
            Some(lens) => Some(
                Undistortion::new(&camera, lens).ok_or_else(|| PhotoError::Lens { name: name.clone() })?,
            ),
        };
        let camera = match &undistortion {
            Some(undistortion) => undistortion.camera(&camera)?,
            None => camera,
        };
        let camera = cut(&camera, if is_low_resolution { self.scale } else { 1 })?;
        let mut way = Vec::new();
        if is_low_resolution {
            let depth = Depth::seen(rasterizer, &camera).map_err(EvaluateError::from)?;
            // As many frames as a history remembers.
            let count = (self.scale * self.scale) as usize;
            way = approach(&camera, self.capture.cameras(), count, &depth);
        }
        Ok(Photo { name, file: file.to_owned(), camera, undistortion, way })
    }

    /// The file of the photo `name`.
    fn find(&self, name: &str) -> Result<PathBuf, PhotoError> {
        let folders = self.folders();
        for folder in &folders {
            let exact = folder.join(name);
            let extended = EXTENSIONS.iter().flat_map(|e| [e.to_string(), e.to_uppercase()]);
            let mut candidates = std::iter::once(exact.clone())
                .chain(extended.map(|e| PathBuf::from(format!("{}.{e}", exact.display()))));
            if let Some(file) = candidates.find(|file| file.is_file()) {
                return Ok(file);
            }
        }
        // Captures that went through systems that do not tell letters' cases apart.
        if let Some(file) = folders.iter().find_map(|folder| alike(folder, name)) {
            return Ok(file);
        }
        Err(PhotoError::Missing { name: name.into(), folders })
    }

    /// Folders that may hold the photos. COLMAP keeps `images` beside `sparse/0`, others name files from their own
    /// folder.
    fn folders(&self) -> Vec<PathBuf> {
        if let Some(images) = &self.images {
            return vec![images.clone()];
        }
        let capture = &self.capture_path;
        let own = if capture.is_dir() { Some(capture.as_path()) } else { capture.parent() };
        let ancestors = own.into_iter().flat_map(|own| own.ancestors().take(3));
        ancestors
            .enumerate()
            .flat_map(|(i, f)| [(i == 0).then(|| f.to_owned()), Some(f.join("images"))])
            .flatten()
            .collect()
    }

    /// Cameras of photos that are not judged.
    fn training(&self, there: &[(usize, PathBuf)], every: usize) -> Result<Vec<Camera>, PhotoError> {
        let outside: Vec<usize> =
            there.iter().enumerate().filter(|(i, _)| i % every != 0).map(|(_, (index, _))| *index).collect();
        let count = TRAINING_PHOTOS.min(outside.len());
        (0..count)
            .map(|i| {
                let index = outside[(2 * i + 1) * outside.len() / (2 * count)];
                Ok(cut(&self.capture.cameras()[index], self.scale)?)
            })
            .collect()
    }

    /// Judges a method; where it `has_history`, details are of frames at the end of the way.
    fn judge(
        &self,
        method: &mut dyn Method,
        has_history: bool,
        photos: &[Photo],
        progress: &mut dyn FnMut(usize),
    ) -> Result<PhotoMethodScore, PhotoError> {
        let mut score = PhotoMethodScore::default();
        for (i, photo) in photos.iter().enumerate() {
            let (width, height) = (photo.camera.width() as usize, photo.camera.height() as usize);
            let read = file::read(&photo.file, self.background)?;
            let read = photo.undistortion.as_ref().map(|u| u.apply(&read)).unwrap_or(read);
            let truth = top_left(&read, width, height);
            method.reset();
            let shown = method.render(&photo.camera, &[]).map_err(EvaluateError::from)?.current;
            let mut image = as_file(shown);
            let alone = photo_score(&truth, &image).map_err(EvaluateError::from)?;
            let mut after_way = alone;
            if has_history && !photo.way.is_empty() {
                image = as_file(shown_after(method, photo)?);
                after_way = photo_score(&truth, &image).map_err(EvaluateError::from)?;
            }
            let (name, size) = (photo.name.clone(), [width, height]);
            score.images.push(PhotoImage { name, size, score: alone, after_way });
            if i % photos.len().div_ceil(SHOWN) == 0 {
                score.crops.push((photo.name.clone(), crop(&truth, &image)));
            }
            progress(i + 1);
        }
        Ok(score)
    }

    /// Everything that results depend on but the methods and what they read, which [`part_of`] tells apart.
    fn key(&self, photos: &[Photo]) -> String {
        let Self { scene_name, scale, culling, background, .. } = self;
        // Another photo with the same name is detected by its length and time.
        let state = |p: &Photo| std::fs::metadata(&p.file).map(|m| (m.len(), m.modified().ok())).ok();
        let cameras: Vec<_> = photos.iter().map(|p| (&p.file, state(p), p.camera, &p.way)).collect();
        let scene = digest::of_scene(&self.scene);
        // Those that are not judged are what methods fit to.
        let capture = digest::of(&format!("{:?}", self.capture));
        format!(
            "gs3-evaluate photos {} {scene_name} {scene:016x} {capture:016x} x{scale} {culling:?} {background:?} {cameras:?}",
            env!("CARGO_PKG_VERSION"),
        )
    }
}

/// The only file in `folder` with the name `name`, or with `name` and an extension of photos, ignoring case.
fn alike(folder: &Path, name: &str) -> Option<PathBuf> {
    let wanted = folder.join(name);
    let (parent, name) = (wanted.parent()?, wanted.file_name()?.to_str()?.to_lowercase());
    let is_alike = |file: &PathBuf| {
        let found = file.file_name().and_then(|found| found.to_str()).unwrap_or_default().to_lowercase();
        found == name || EXTENSIONS.iter().any(|extension| found == format!("{name}.{extension}"))
    };
    let files = std::fs::read_dir(parent).ok()?.flatten().map(|entry| entry.path());
    let mut found = files.filter(|file| file.is_file() && is_alike(file));
    // Two files that differ only in case cannot be distinguished.
    found.next().filter(|_| found.next().is_none())
}

/// What `method` shows at `photo` after the frames before it.
fn shown_after<'a>(method: &'a mut dyn Method, photo: &Photo) -> Result<&'a Image, PhotoError> {
    method.reset();
    for camera in &photo.way {
        method.render(camera, &[]).map_err(EvaluateError::from)?;
    }
    Ok(method.render(&photo.camera, &[]).map_err(EvaluateError::from)?.current)
}

/// `camera` with images of `size`, if that is its image's at another scale: each side may be off by the rounding of a
/// reduction to whole pixels, up or down. Both axes keep their field of view, as in training on reduced images.
fn following(camera: &Camera, size: Size) -> Option<Result<Camera, CameraError>> {
    let (old, Size { width, height }) = (camera.intrinsics(), size);
    let (sx, sy) = (f64::from(width) / f64::from(old.width), f64::from(height) / f64::from(old.height));
    // The sides that the other side's scale gives, against the sides found.
    let off = [f64::from(old.width) * sy - f64::from(width), f64::from(old.height) * sx - f64::from(height)];
    // One rounding of a pixel for the side itself, and one of the other side carried over by the aspect.
    let aspect = f64::from(old.width) / f64::from(old.height);
    let allowed = [1.0 + aspect, 1.0 + 1.0 / aspect];
    let fits = size == old.size() || (0..2).all(|i| off[i].abs() < allowed[i]);
    fits.then(|| {
        let (fx, cx) = (old.fx * sx, old.cx * sx);
        let (fy, cy) = (old.fy * sy, old.cy * sy);
        Camera::new(camera.view_from_world(), Intrinsics { width, height, fx, fy, cx, cy })
    })
}

/// `camera` without the last columns and rows that do not fill a block of `multiple`², if there is a whole block.
fn cut(camera: &Camera, multiple: u32) -> Result<Camera, CameraError> {
    let whole = |side: u32| if side < multiple { side } else { side - side % multiple };
    let Intrinsics { width, height, .. } = camera.intrinsics();
    let cut = Intrinsics { width: whole(width), height: whole(height), ..camera.intrinsics() };
    Camera::new(camera.view_from_world(), cut)
}

/// The top left part of `image`, `width`×`height`, which are at most its own.
fn top_left(image: &Image, width: usize, height: usize) -> Image {
    let pixels = (0..height).flat_map(|y| image.row(y)[..width].iter().copied()).collect();
    Image::from_pixels(width, height, pixels).unwrap_or_default()
}

/// `image` as an 8-bit file of it would be read.
fn as_file(image: &Image) -> Image {
    let bytes = image.to_rgb8();
    let pixels = bytes.as_chunks().0.iter().map(|[r, g, b]| {
        let [r, g, b] = [r, g, b].map(|v| f32::from(*v) / 255.0);
        [r, g, b, 1.0]
    });
    Image::from_pixels(image.width(), image.height(), pixels.collect()).unwrap_or_default()
}

fn photo_score(truth: &Image, image: &Image) -> Result<PhotoScore, crate::metrics::MetricError> {
    Ok(PhotoScore {
        psnr: psnr(truth, image, Quantisation::None)?.min(PSNR_CAP),
        ssim: ssim(truth, image, SsimBorder::ZeroPad)?,
        flip: flip(truth, image, DEFAULT_PIXELS_PER_DEGREE)?,
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use glam::DAffine3;

    #[test]
    fn cameras_follow_reduced_photos_and_no_others() {
        let intrinsics =
            Intrinsics { width: 4946, height: 3286, fx: 4000.0, fy: 4010.0, cx: 2400.0, cy: 1650.0 };
        let camera = Camera::new(DAffine3::IDENTITY, intrinsics).unwrap();
        // A quarter, rounded either way (1236.5, 821.5), as collections of reduced photos have them.
        for size in
            [[4946, 3286], [1236, 821], [1237, 822], [1237, 821], [1236, 822], [2473, 1643]].map(Size::from)
        {
            let followed = following(&camera, size).unwrap().unwrap().intrinsics();
            assert_eq!(followed.size(), size);
            let share = |i: Intrinsics| [i.fx / f64::from(i.width), i.cy / f64::from(i.height)];
            assert!((share(followed)[0] - share(intrinsics)[0]).abs() < 1e-12);
            assert!((share(followed)[1] - share(intrinsics)[1]).abs() < 1e-12);
        }
        for size in [[3286, 4946], [1236, 828], [1920, 1080], [1228, 822]].map(Size::from) {
            assert!(following(&camera, size).is_none(), "{size:?}");
        }
    }
}
