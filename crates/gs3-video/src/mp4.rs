//! The file: MP4 (ISO/IEC 14496-12 and -15) with one track of H.264.
//!
//! The index of frames comes before the frames, so that a page can show the video while it loads. Space for the index
//! is reserved at the beginning and filled in at the end.

use std::io::{self, Seek, SeekFrom, Write};

use crate::VideoError;
use crate::h264::{AccessUnit, BT709};

/// What the frames of a file are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track {
    /// Width and height of the pictures in pixels.
    pub size: [usize; 2],
    /// Frames per second, above 0 and at most 1000.
    pub rate: f64,
    /// Frames from one key frame to the next.
    pub key_interval: usize,
}

/// A file in the making.
#[derive(Debug)]
pub struct Mp4<W> {
    out: W,
    track: Track,
    /// Where the space reserved for the index begins, and its length.
    room: (u64, u64),
    /// Where the frames begin.
    frames_at: u64,
    /// Length of each frame in bytes, and whether it is a key frame.
    frames: Vec<(u32, bool)>,
}

/// Bytes of an index without its frames, parameter sets included; a test holds it to that.
const INDEX: u64 = 1024;
/// Bytes that a frame takes in the index, and a key frame beyond that: its number, its place, its chunk's length.
const PER_FRAME: u64 = 4;
const PER_KEY_FRAME: u64 = 4 + 8 + 12;
/// Bytes of the header of a box with its length in eight bytes.
const HEADER: u64 = 8;
const LONG_HEADER: u64 = 16;

impl<W: Write + Seek> Mp4<W> {
    /// Begins a file of about `frames` frames. Space for their index is reserved; with more frames, the index goes to
    /// the end of the file.
    ///
    /// # Errors
    /// [`VideoError::Rate`] for a rate outside 0 to 1000, and what writing reports.
    pub fn new(mut out: W, track: Track, frames: usize) -> Result<Self, VideoError> {
        if !(track.rate > 0.0 && track.rate <= 1000.0) {
            return Err(VideoError::Rate { actual: track.rate });
        }
        let brands = Content::default().bytes(b"isom").int(512).bytes(b"isomiso2avc1mp41");
        out.write_all(&brands.boxed(b"ftyp"))?;
        let room_at = out.stream_position()?;
        let keys = frames.div_ceil(track.key_interval.max(1)) as u64;
        let room = INDEX + PER_FRAME * frames as u64 + PER_KEY_FRAME * keys;
        out.write_all(&free(room))?;
        // Its length is filled in at the end.
        out.write_all(&long_header(b"mdat", LONG_HEADER))?;
        let frames_at = out.stream_position()?;
        Ok(Self { out, track, room: (room_at, room), frames_at, frames: Vec::new() })
    }

    /// Adds the next frame.
    ///
    /// # Errors
    /// What writing reports.
    pub fn write(&mut self, unit: &AccessUnit) -> Result<(), VideoError> {
        let length = u32::try_from(unit.bytes.len()).map_err(|_| io::Error::other("a frame beyond 4 GB"))?;
        self.out.write_all(&unit.bytes)?;
        self.frames.push((length, unit.is_key));
        Ok(())
    }

    /// Writes the index, with the `parameters` of sequence and pictures, and gives the file back.
    ///
    /// # Errors
    /// What writing reports.
    pub fn finish(mut self, parameters: [&[u8]; 2]) -> Result<W, VideoError> {
        let length: u64 = self.frames.iter().map(|(length, _)| u64::from(*length)).sum();
        let index = self.index(parameters);
        let (at, room) = self.room;
        let left = room.checked_sub(index.len() as u64);
        match left.filter(|left| *left == 0 || *left >= HEADER) {
            Some(left) => {
                self.out.seek(SeekFrom::Start(at))?;
                self.out.write_all(&index)?;
                if left > 0 {
                    self.out.write_all(&free(left)[..HEADER as usize])?;
                }
            }
            None => self.out.write_all(&index)?,
        }
        self.out.seek(SeekFrom::Start(self.frames_at - LONG_HEADER))?;
        self.out.write_all(&long_header(b"mdat", length + LONG_HEADER))?;
        self.out.seek(SeekFrom::End(0))?;
        Ok(self.out)
    }

    /// The box `moov`.
    fn index(&self, parameters: [&[u8]; 2]) -> Vec<u8> {
        let (scale, step) = time_base(self.track.rate);
        let duration = u64::from(step) * self.frames.len() as u64;
        let [width, height] = self.track.size.map(|side| side as u32);
        let movie = Content::default()
            .zeros(UNKNOWN_TIMES)
            .int(scale)
            .long(duration)
            // Rate 1, volume 1, reserved.
            .int(0x1_0000)
            .bytes(&[1, 0])
            .zeros(10)
            .ints(&IDENTITY)
            .zeros(24)
            // The next track's number.
            .int(2)
            .full(b"mvhd", 1, 0);
        let track = Content::default()
            .zeros(UNKNOWN_TIMES)
            // The track's number, reserved.
            .int(1)
            .int(0)
            .long(duration)
            // Reserved, layer, alternate group, volume, reserved.
            .zeros(16)
            .ints(&IDENTITY)
            .int(width << 16)
            .int(height << 16)
            // The track is enabled, in the movie and in its preview.
            .full(b"tkhd", 1, 7);
        let media = Content::default()
            .zeros(UNKNOWN_TIMES)
            .int(scale)
            .long(duration)
            // No language.
            .bytes(&[0x55, 0xc4, 0, 0])
            .full(b"mdhd", 1, 0);
        let handler =
            Content::default().int(0).bytes(b"vide").zeros(12).bytes(b"video\0").full(b"hdlr", 0, 0);
        let video = Content::default().zeros(8).full(b"vmhd", 0, 1);
        // The frames are in this file.
        let here = Content::default().full(b"url ", 0, 1);
        let places = Content::default().int(1).bytes(&here).full(b"dref", 0, 0);
        let information = [video, boxed(b"dinf", &places), self.frame_table(parameters, step)].concat();
        let media = [media, handler, boxed(b"minf", &information)].concat();
        let track = [track, boxed(b"mdia", &media)].concat();
        boxed(b"moov", &[movie, boxed(b"trak", &track)].concat())
    }

    /// The box `stbl`: what frames are, how long each is shown and where it lies.
    fn frame_table(&self, parameters: [&[u8]; 2], step: u32) -> Vec<u8> {
        let count = self.frames.len() as u32;
        let numbered = || (1..).zip(&self.frames);
        let keys: Vec<u32> =
            numbered().filter(|(_, (_, is_key))| *is_key).map(|(number, _)| number).collect();
        let lengths: Vec<u32> = self.frames.iter().map(|(length, _)| *length).collect();
        // A chunk from each key frame to the next: where it begins, and its number of frames.
        let mut chunks: Vec<(u64, u32)> = Vec::new();
        let mut at = self.frames_at;
        for (length, is_key) in &self.frames {
            match chunks.last_mut() {
                Some((_, frames)) if !is_key => *frames += 1,
                _ => chunks.push((at, 1)),
            }
            at += u64::from(*length);
        }
        // Of chunks of equal length that follow each other, the first one's number, the length, their description's.
        let mut runs: Vec<[u32; 3]> = Vec::new();
        for (number, (_, frames)) in (1..).zip(&chunks) {
            if runs.last().is_none_or(|[_, before, _]| before != frames) {
                runs.push([number, *frames, 1]);
            }
        }
        let places =
            chunks.iter().fold(Content::default().int(chunks.len() as u32), |list, (at, _)| list.long(*at));
        let table = [
            Content::default().int(1).bytes(&self.description(parameters)).full(b"stsd", 0, 0),
            Content::default().int(1).int(count).int(step).full(b"stts", 0, 0),
            Content::default().int(keys.len() as u32).ints(&keys).full(b"stss", 0, 0),
            Content::default().int(runs.len() as u32).ints(runs.as_flattened()).full(b"stsc", 0, 0),
            // Lengths differ.
            Content::default().int(0).int(count).ints(&lengths).full(b"stsz", 0, 0),
            places.full(b"co64", 0, 0),
        ];
        boxed(b"stbl", &table.concat())
    }

    /// The box `avc1`.
    fn description(&self, parameters: [&[u8]; 2]) -> Vec<u8> {
        let [width, height] = self.track.size.map(|side| (side as u16).to_be_bytes());
        let content = Content::default()
            // Reserved, the number of the data's place, reserved.
            .bytes(&[0, 0, 0, 0, 0, 0, 0, 1])
            .zeros(16)
            .bytes(&width)
            .bytes(&height)
            // 72 dots per inch both ways, reserved.
            .ints(&[0x48_0000, 0x48_0000, 0])
            // A frame at a time, a compressor without a name, 24 bits a pixel, no table of colours.
            .bytes(&[0, 1])
            .zeros(32)
            .bytes(&[0, 24, 0xff, 0xff])
            .bytes(&decoder_configuration(parameters))
            // Primaries, transfer, matrix, limited range.
            .bytes(&boxed(b"colr", &[&b"nclx"[..], &[0, BT709, 0, BT709, 0, BT709, 0]].concat()))
            // Square pixels.
            .bytes(&Content::default().ints(&[1, 1]).boxed(b"pasp"));
        content.boxed(b"avc1")
    }
}

/// Bytes of two times, of creation and of change, which are left unknown.
const UNKNOWN_TIMES: usize = 16;

/// The picture as it is: a matrix of fixed-point numbers with 16 binary places, 30 in its last column.
const IDENTITY: [u32; 9] = [0x1_0000, 0, 0, 0, 0x1_0000, 0, 0, 0, 0x4000_0000];

/// The content of a box, most significant bytes first.
#[derive(Default)]
struct Content(Vec<u8>);

impl Content {
    fn bytes(mut self, bytes: &[u8]) -> Self {
        self.0.extend(bytes);
        self
    }

    fn zeros(mut self, count: usize) -> Self {
        self.0.resize(self.0.len() + count, 0);
        self
    }

    fn int(self, value: u32) -> Self {
        self.bytes(&value.to_be_bytes())
    }

    fn ints(self, values: &[u32]) -> Self {
        values.iter().fold(self, |content, value| content.int(*value))
    }

    fn long(self, value: u64) -> Self {
        self.bytes(&value.to_be_bytes())
    }

    /// The box of this content.
    fn boxed(self, kind: &[u8; 4]) -> Vec<u8> {
        boxed(kind, &self.0)
    }

    /// The box of this content after a version and flags.
    fn full(self, kind: &[u8; 4], version: u8, flags: u32) -> Vec<u8> {
        let [_, flags @ ..] = flags.to_be_bytes();
        Self::default().bytes(&[version]).bytes(&flags).bytes(&self.0).boxed(kind)
    }
}

/// The box `avcC` (ISO/IEC 14496-15, section 5.3.3): profile and level, lengths of four bytes, one set of each kind.
fn decoder_configuration([sequence, picture]: [&[u8]; 2]) -> Vec<u8> {
    let byte = |i: usize| sequence.get(i).copied().unwrap_or_default();
    let mut content = Content::default().bytes(&[1, byte(1), byte(2), byte(3), 0xff]);
    for (count, set) in [(0xe1, sequence), (1, picture)] {
        content = content.bytes(&[count]).bytes(&(set.len() as u16).to_be_bytes()).bytes(set);
    }
    // Profiles above Main say 4:2:0, 8 bits of luma and of chroma, and no extensions.
    let format: &[u8] = if byte(1) >= 100 { &[0xfd, 0xf8, 0xf8, 0] } else { &[] };
    content.bytes(format).boxed(b"avcC")
}

/// Units of time a second, and units from one frame to the next. Their quotient is `rate` within 1 in 10⁹, or as
/// nearly as numbers below 2³¹ allow: the first convergent of its continued fraction that is near enough. So
/// 29.97002997… is 30000/1001.
fn time_base(rate: f64) -> (u32, u32) {
    const LARGEST: f64 = (1_u32 << 31) as f64;
    // Numerators and denominators of the last two convergents.
    let ([mut n0, mut n1], [mut d0, mut d1]) = ([1.0, rate.floor()], [0.0, 1.0]);
    let mut rest = rate.fract();
    while (n1 / d1 - rate).abs() > 1e-9 * rate && rest > 0.0 {
        let inverse = 1.0 / rest;
        let (n, d) = (inverse.floor() * n1 + n0, inverse.floor() * d1 + d0);
        if n > LARGEST || d > LARGEST {
            break;
        }
        ([n0, n1], [d0, d1]) = ([n1, n], [d1, d]);
        rest = inverse.fract();
    }
    // Some players count in units of at least a millisecond.
    let times = (1000.0 / n1.max(1.0)).ceil();
    let times = if times * d1.max(n1) > LARGEST { 1.0 } else { times };
    ((n1 * times).max(1.0) as u32, (d1 * times).max(1.0) as u32)
}

/// A box of this kind and content.
fn boxed(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let length = (HEADER as usize + content.len()) as u32;
    [&length.to_be_bytes()[..], kind, content].concat()
}

/// An empty box `length` bytes long.
fn free(length: u64) -> Vec<u8> {
    boxed(b"free", &vec![0; (length - HEADER) as usize])
}

/// The header of a box `length` bytes long, its length in eight bytes.
fn long_header(kind: &[u8; 4], length: u64) -> Vec<u8> {
    Content::default().int(1).bytes(kind).long(length).0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_rates_are_fractions() {
        for (rate, expected) in [
            (30.0, (1020, 34)),
            (60.0, (1020, 17)),
            (29.97, (2997, 100)),
            (30_000.0 / 1001.0, (30_000, 1001)),
            (23.976_023_976_023_978, (24_000, 1001)),
            (0.5, (1000, 2000)),
        ] {
            assert_eq!(time_base(rate), expected, "{rate}");
        }
        for rate in [1e-9, 1e-3, 1.0 / 3.0, std::f64::consts::PI, 12.345_678_9, 999.999_999] {
            let (scale, step) = time_base(rate);
            let found = f64::from(scale) / f64::from(step);
            assert!((found / rate - 1.0).abs() < 1e-8, "{rate}: {scale}/{step}");
        }
    }
}
