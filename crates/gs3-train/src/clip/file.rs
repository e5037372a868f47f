//! Clips as files: safetensors with a header. Parts of a file can be read on their own.
//!
//! Header texts: `clip` (version of this format), `network`, `scene`, `scale`. Arrays: `inputs/NAME`, f16, and
//! `target`, u16; both `[frames, height, width, channels]`.

use std::collections::HashMap;
use std::fs::File;
use std::io::{Cursor, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use gs3_files::write_atomically;
use gs3_neural::arrays::sort_header;
use gs3_neural::model::Tier;
use half::f16;
use safetensors::tensor::{Dtype, Metadata, TensorView};

use super::{Clip, ClipError, ClipFrame, ClipPlane, ClipWindow, HIDDEN, Network};

/// Version of the format.
const VERSION: &str = "1";

/// The longest safetensors header that is read: thousands of times a clip's.
const MAX_HEADER: u64 = 1 << 20;

/// A clip on disk. Parts are read when they are needed.
#[derive(Clone, Debug)]
pub struct ClipFile {
    path: PathBuf,
    head: Head,
}

/// Where what is in a file.
#[derive(Clone, Debug)]
struct Head {
    network: Network,
    scene: String,
    scale: u32,
    frames: usize,
    lr: [usize; 2],
    inputs: Vec<Stored>,
    target: Stored,
}

/// An array in a file: `[frames, height, width, channels]`, two bytes a number.
#[derive(Clone, Debug)]
struct Stored {
    /// Name without `inputs/`.
    name: String,
    /// Where it begins, from the start of the file.
    offset: u64,
    /// Pixels per LR pixel along a side.
    factor: usize,
    channels: usize,
}

impl Clip {
    /// As a safetensors file.
    ///
    /// # Errors
    /// [`ClipError`] if the clip is not whole.
    pub fn to_bytes(&self) -> Result<Vec<u8>, ClipError> {
        self.check()?;
        let side = self.lr.map(|side| side * self.scale as usize);
        let shape = |numbers: usize, channels: usize| {
            let [height, width] = if numbers == self.lr[0] * self.lr[1] * channels { self.lr } else { side };
            vec![self.frames.len(), height, width, channels]
        };
        let mut arrays = vec![];
        for (k, plane) in self.frames[0].inputs.iter().enumerate() {
            let bytes =
                self.frames.iter().flat_map(|frame| &frame.inputs[k].values).flat_map(|v| v.to_le_bytes());
            let shape = shape(plane.values.len(), plane.channels);
            arrays.push((format!("inputs/{}", plane.name), Dtype::F16, shape, bytes.collect::<Vec<u8>>()));
        }
        let bytes = self.frames.iter().flat_map(|frame| &frame.target).flat_map(|v| v.to_le_bytes());
        let shape = vec![self.frames.len(), side[0], side[1], 3];
        arrays.push(("target".to_owned(), Dtype::U16, shape, bytes.collect()));
        let mut views = Vec::with_capacity(arrays.len());
        for (name, dtype, shape, bytes) in &arrays {
            views.push((name, TensorView::new(*dtype, shape.clone(), bytes).map_err(format_error)?));
        }
        let texts = [
            ("clip", VERSION.to_owned()),
            ("network", self.network.name().to_owned()),
            ("scene", self.scene.clone()),
            ("scale", self.scale.to_string()),
        ];
        let texts: HashMap<String, String> = texts.map(|(name, text)| (name.to_owned(), text)).into();
        let mut bytes = safetensors::serialize(views, Some(texts)).map_err(format_error)?;
        sort_header(&mut bytes);
        Ok(bytes)
    }

    /// From a safetensors file in memory.
    ///
    /// # Errors
    /// [`ClipError`] if it is something else.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ClipError> {
        let mut source = Cursor::new(bytes);
        let head = Head::read(&mut source)?;
        let window = ClipWindow { frames: 0..head.frames, rows: 0..head.lr[0], columns: 0..head.lr[1] };
        head.window(&mut source, &window)
    }

    /// Writes a file, whole or not at all.
    ///
    /// # Errors
    /// [`ClipError`] if it cannot be written or the clip is not whole.
    pub fn save(&self, path: &Path) -> Result<(), ClipError> {
        let write = |source| ClipError::File { path: path.to_owned(), source };
        let bytes = self.to_bytes()?;
        write_atomically(path, |writer| writer.write_all(&bytes)).map_err(write)
    }
}

impl ClipFile {
    /// Opens a file and reads what it holds, not the frames.
    ///
    /// # Errors
    /// [`ClipError`] if it cannot be read or is no clip.
    pub fn open(path: &Path) -> Result<Self, ClipError> {
        let within = |source| ClipError::Within { path: path.to_owned(), source: Box::new(source) };
        let file = File::open(path).map_err(|source| within(source.into()))?;
        let head = Head::read(&mut &file).map_err(within)?;
        Ok(Self { path: path.to_owned(), head })
    }

    /// Reads the part of the clip within `window`, as [`Clip::crop`].
    ///
    /// # Errors
    /// [`ClipError`] if the window is empty or not within the clip, or the file has changed.
    pub fn read(&self, window: &ClipWindow) -> Result<Clip, ClipError> {
        let within = |source| ClipError::Within { path: self.path.clone(), source: Box::new(source) };
        let file = File::open(&self.path).map_err(|source| within(source.into()))?;
        self.head.window(&mut &file, window).map_err(within)
    }

    /// Reads no inputs but `names` from now on.
    pub(crate) fn keep(&mut self, names: &[&str]) {
        self.head.inputs.retain(|stored| names.contains(&&*stored.name));
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The network it is for.
    #[must_use]
    pub fn network(&self) -> Network {
        self.head.network
    }

    /// [`Clip::scene`].
    #[must_use]
    pub fn scene(&self) -> &str {
        &self.head.scene
    }

    /// HR pixels per LR pixel along a side.
    #[must_use]
    pub fn scale(&self) -> u32 {
        self.head.scale
    }

    /// How many frames it has.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.head.frames
    }

    /// Size of the LR grid, `[height, width]`.
    #[must_use]
    pub fn lr(&self) -> [usize; 2] {
        self.head.lr
    }
}

impl Head {
    /// Reads the header of a file and checks that the arrays fit the network.
    fn read(source: &mut (impl Read + Seek)) -> Result<Self, ClipError> {
        let length = source.seek(SeekFrom::End(0))?;
        source.rewind()?;
        let mut size = [0; 8];
        source.read_exact(&mut size)?;
        let size = u64::from_le_bytes(size);
        if size > MAX_HEADER.min(length) {
            return Err(ClipError::Format { message: format!("a header of {size} bytes") });
        }
        let mut json = vec![0; size as usize];
        source.read_exact(&mut json)?;
        let metadata: Metadata = serde_json::from_slice(&json).map_err(format_error)?;
        if (8 + size).checked_add(metadata.data_len() as u64) != Some(length) {
            let expected = metadata.data_len();
            return Err(ClipError::Format { message: format!("{length} bytes, arrays need {expected}") });
        }
        Self::check(&metadata, 8 + size)
    }

    /// Checks that the arrays, which begin at byte `data`, fit the network that the header names.
    fn check(metadata: &Metadata, data: u64) -> Result<Self, ClipError> {
        let text = |field: &'static str, expected: &str| {
            let found = metadata.metadata().as_ref().and_then(|texts| texts.get(field));
            found.cloned().ok_or_else(|| header_error(field, expected, "none"))
        };
        let version = text("clip", VERSION)?;
        if version != VERSION {
            return Err(header_error("clip", VERSION, &version));
        }
        let name = text("network", "a network")?;
        let network = Network::from_name(&name)
            .ok_or_else(|| header_error("network", &Network::ALL.map(Network::name).join(" or "), &name))?;
        let scale = text("scale", "a number")?;
        let scale: u32 = scale.parse().map_err(|_| header_error("scale", "a number", &scale))?;
        // Inputs that clips hold are the same for all tiers.
        let graph = network.graph(scale, Tier::Fast)?;
        let (frames, lr) = frames_and_lr(metadata, scale as usize)?;
        let shapes = graph.shapes(lr)?;

        let stored = |name: &str, dtype: Dtype, [height, width, channels]: [usize; 3]| {
            let shape = [frames, height, width, channels];
            let found = metadata.info(name);
            match found.filter(|info| info.dtype == dtype && info.shape == shape) {
                Some(info) => Ok(Stored {
                    name: name.trim_start_matches("inputs/").to_owned(),
                    offset: data + info.data_offsets.0 as u64,
                    factor: height / lr[0],
                    channels,
                }),
                None => Err(ClipError::Array {
                    name: name.to_owned(),
                    expected: format!("{dtype} {shape:?}"),
                    actual: found
                        .map_or("none".to_owned(), |info| format!("{} {:?}", info.dtype, info.shape)),
                }),
            }
        };
        let mut inputs = Vec::new();
        for (tensor, layer) in graph.inputs().filter(|(_, layer)| layer.name != HIDDEN) {
            let shape = shapes[tensor.index()];
            let shape = [shape.height, shape.width, shape.channels];
            inputs.push(stored(&format!("inputs/{}", layer.name), Dtype::F16, shape)?);
        }
        let target = stored("target", Dtype::U16, [lr[0] * scale as usize, lr[1] * scale as usize, 3])?;
        let known = |name: &str| {
            name == "target" || inputs.iter().any(|i| Some(&*i.name) == name.strip_prefix("inputs/"))
        };
        if let Some(name) = metadata.offset_keys().into_iter().find(|name| !known(name)) {
            return Err(ClipError::Unknown { name });
        }
        Ok(Self { network, scene: text("scene", "a name")?, scale, frames, lr, inputs, target })
    }

    /// Reads a part of the clip.
    fn window(&self, source: &mut (impl Read + Seek), window: &ClipWindow) -> Result<Clip, ClipError> {
        window.check(self.frames, self.lr)?;
        let mut frames = Vec::with_capacity(window.frames.len());
        for frame in window.frames.clone() {
            let mut inputs = Vec::with_capacity(self.inputs.len());
            for stored in &self.inputs {
                let values = self.part(source, stored, frame, window, f16::from_le_bytes)?;
                inputs.push(ClipPlane { name: stored.name.clone(), channels: stored.channels, values });
            }
            frames.push(ClipFrame {
                inputs,
                target: self.part(source, &self.target, frame, window, u16::from_le_bytes)?,
            });
        }
        let (network, scene, scale) = (self.network, self.scene.clone(), self.scale);
        let mut clip = Clip { network, scene, scale, lr: window.lr(), frames };
        clip.forget_outside();
        Ok(clip)
    }

    /// The pixels of an array in one frame within `window`. Rows are read whole and together: one request is cheaper
    /// than many small ones.
    fn part<T>(
        &self,
        source: &mut (impl Read + Seek),
        stored: &Stored,
        frame: usize,
        window: &ClipWindow,
        number: impl Fn([u8; 2]) -> T,
    ) -> Result<Vec<T>, ClipError> {
        let pixel = 2 * stored.channels * stored.factor;
        let row = self.lr[1] * pixel;
        let rows = window.rows.start * stored.factor..window.rows.end * stored.factor;
        let first = frame * self.lr[0] * stored.factor + rows.start;
        source.seek(SeekFrom::Start(stored.offset + (first * row) as u64))?;
        let mut bytes = vec![0; rows.len() * row];
        source.read_exact(&mut bytes)?;
        let columns = window.columns.start * pixel..window.columns.end * pixel;
        let mut values = Vec::with_capacity(rows.len() * columns.len() / 2);
        for row in bytes.chunks_exact(row) {
            values.extend(row[columns.clone()].as_chunks().0.iter().map(|bytes| number(*bytes)));
        }
        Ok(values)
    }
}

/// How many frames of what LR size the target has.
fn frames_and_lr(metadata: &Metadata, scale: usize) -> Result<(usize, [usize; 2]), ClipError> {
    let shape = metadata.info("target").map(|info| &info.shape[..]);
    match shape {
        Some([frames, height, width, 3]) if *frames > 0 && height % scale == 0 && width % scale == 0 => {
            Ok((*frames, [height / scale, width / scale]))
        }
        _ => Err(ClipError::Array {
            name: "target".to_owned(),
            expected: format!("U16 [frames, {scale}·height, {scale}·width, 3]"),
            actual: shape.map_or("none".to_owned(), |shape| format!("{shape:?}")),
        }),
    }
}

fn header_error(field: &'static str, expected: &str, actual: &str) -> ClipError {
    ClipError::Header { field, expected: expected.to_owned(), actual: actual.to_owned() }
}

fn format_error(error: impl ToString) -> ClipError {
    ClipError::Format { message: error.to_string() }
}
