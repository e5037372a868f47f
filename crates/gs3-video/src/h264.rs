//! The video stream: H.264 (ITU-T H.264), encoded by `rusty_h264`, with the parameter sets that say what its colours mean.

use rusty_h264_common::nal::{emulation_prevent_into, emulation_unprevent, split_annex_b};
use rusty_h264_common::{BitWriter, YuvPlanes};
use rusty_h264_encoder::{EncoderConfig, Preset};

use crate::{Picture, VideoError};

/// How coarsely frames are quantised, from 0 to 51. Empirical: on rendered frames, file size and fidelity are about
/// those of x264 at its quality 17 (see the crate's test of fidelity, which limits the mean error to 43 dB).
const QUANTISER: u8 = 18;

/// A key frame comes at least this often, in seconds: players go to any moment from the key frame before it.
const KEY_SECONDS: f64 = 2.0;

/// What a level lets a decoder expect (table A-1): its number times 10, macroblocks per second, macroblocks per frame.
/// Levels below 3 and those that differ from another in bit rate alone are left out.
const LEVELS: [(u8, f64, usize); 9] = [
    (30, 40_500.0, 1620),
    (31, 108_000.0, 3600),
    (32, 216_000.0, 5120),
    (40, 245_760.0, 8192),
    (42, 522_240.0, 8704),
    (51, 983_040.0, 36_864),
    (52, 2_073_600.0, 36_864),
    (61, 8_355_840.0, 139_264),
    (62, 16_711_680.0, 139_264),
];

/// Longest side of a frame; level 6 allows a few pixels more.
const LONGEST_SIDE: usize = 16_384;

/// Kinds of the units of a stream (table 7-1).
const KEY_SLICE: u8 = 5;
const SEQUENCE_PARAMETERS: u8 = 7;
const PICTURE_PARAMETERS: u8 = 8;

/// Codes of BT.709 for primaries, transfer and matrix (tables E-3 to E-5), which MP4 shares (ISO/IEC 23091-2).
pub(crate) const BT709: u8 = 1;

/// One encoded frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AccessUnit {
    /// Its units, each after its length in four bytes, most significant first, as MP4 holds them.
    pub bytes: Vec<u8>,
    /// Whether decoding can begin here.
    pub is_key: bool,
}

/// Encodes frames one after the other, on the calling thread.
#[derive(Debug)]
pub struct Encoder {
    encoder: rusty_h264_encoder::Encoder,
    parameters: Option<[Vec<u8>; 2]>,
    key_interval: usize,
}

impl Encoder {
    /// An encoder of pictures of `size` (even sides) at `rate` frames per second.
    ///
    /// # Errors
    /// [`VideoError::Size`] if H.264 has no level for `size`, [`VideoError::Rate`] for a rate outside 0 to 1000.
    pub fn new(size: [usize; 2], rate: f64) -> Result<Self, VideoError> {
        if !(rate > 0.0 && rate <= 1000.0) {
            return Err(VideoError::Rate { actual: rate });
        }
        let [width, height] = size;
        let key_interval = ((KEY_SECONDS * rate) as usize).max(1);
        let level = level(size, rate).ok_or(VideoError::Size { actual: [width as u32, height as u32] })?;
        let config = EncoderConfig {
            level_idc: level,
            qp: QUANTISER,
            gop_size: key_interval as u32,
            min_keyint: key_interval as u32,
            // Looking for cuts, and ahead, keeps frames in memory.
            scenecut: 0,
            mbtree: false,
            framerate: rate as f32,
            num_ref_frames: 1,
            preset: Preset::Balanced,
            ..EncoderConfig::new(width, height)
        };
        let encoder = rusty_h264_encoder::Encoder::new(config).map_err(failed)?;
        Ok(Self { encoder, parameters: None, key_interval })
    }

    /// Frames from one key frame to the next.
    #[must_use]
    pub const fn key_interval(&self) -> usize {
        self.key_interval
    }

    /// Encodes the next frame.
    ///
    /// # Errors
    /// [`VideoError::FrameSize`] for a picture of another size, [`VideoError::Encode`] if the encoder fails.
    pub fn encode(&mut self, picture: &Picture) -> Result<AccessUnit, VideoError> {
        let [width, height] = picture.size();
        let config = self.encoder.config();
        if [config.width, config.height] != [width, height] {
            let expected = [config.width, config.height].map(|side| side as u32);
            return Err(VideoError::FrameSize { expected, actual: [width, height].map(|side| side as u32) });
        }
        let [y, u, v] = picture.planes();
        let planes = YuvPlanes { width, height, y, u, v, stride_y: width, stride_c: width / 2 };
        let stream = self.encoder.encode_planes(&planes).map_err(failed)?;
        let mut unit = AccessUnit { bytes: Vec::with_capacity(stream.len() + 16), is_key: false };
        let mut parameters = [None, None];
        for nal in split_annex_b(&stream) {
            match nal.first().map(|header| header & 31) {
                Some(SEQUENCE_PARAMETERS) => parameters[0] = Some(with_colours(nal)),
                Some(PICTURE_PARAMETERS) => parameters[1] = Some(nal.to_vec()),
                Some(kind) => {
                    unit.is_key |= kind == KEY_SLICE;
                    unit.bytes.extend((nal.len() as u32).to_be_bytes());
                    unit.bytes.extend(nal);
                }
                None => {}
            }
        }
        if let [Some(sequence), Some(picture)] = parameters {
            self.parameters = Some([sequence, picture]);
        }
        match unit.bytes.is_empty() {
            true => Err(VideoError::Encode("expected one frame for one frame, found none".to_owned())),
            false => Ok(unit),
        }
    }

    /// The parameter sets of sequence and pictures, once a frame is encoded.
    #[must_use]
    pub fn parameters(&self) -> Option<[&[u8]; 2]> {
        self.parameters.as_ref().map(|both| both.each_ref().map(Vec::as_slice))
    }
}

fn failed(error: rusty_h264_encoder::EncodeError) -> VideoError {
    VideoError::Encode(error.to_string())
}

/// The lowest level that allows the frames.
fn level(size: [usize; 2], rate: f64) -> Option<u8> {
    let macroblocks = size[0].div_ceil(16) * size[1].div_ceil(16);
    let is_size = size.iter().all(|side| (1..=LONGEST_SIDE).contains(side));
    let allows =
        |(_, speed, frame): &&(u8, f64, usize)| *frame >= macroblocks && *speed >= macroblocks as f64 * rate;
    // No level allows the largest frames at all rates; then the highest stands, and decoders do what they can.
    let level = LEVELS.iter().find(allows).or(LEVELS.last().filter(|(.., frame)| *frame >= macroblocks));
    level.filter(|_| is_size).map(|(level, ..)| *level)
}

/// The sequence parameter set `nal` with "VUI" parameters: what colours mean, square pixels, and that frames are shown in
/// the order in which they are decoded.
///
/// The encoder leaves them out, with a flag of 0, and that flag is the last bit of the set before the bit 1 that ends
/// it (section 7.3.2.1.1).
fn with_colours(nal: &[u8]) -> Vec<u8> {
    let (header, payload) = nal.split_at(1);
    let payload = emulation_unprevent(payload);
    let mut bits: Vec<bool> =
        payload.iter().flat_map(|byte| (0..8).rev().map(move |i| byte >> i & 1 == 1)).collect();
    while bits.pop() == Some(false) {}
    if bits.pop() != Some(false) {
        // They are there, if a later version of the encoder writes them.
        return nal.to_vec();
    }
    let mut writer = BitWriter::new();
    bits.into_iter().for_each(|bit| writer.write_bit(bit));
    writer.write_bit(true); // vui_parameters_present_flag
    writer.write_bit(true); // aspect_ratio_info_present_flag
    writer.write_bits(1, 8); // aspect_ratio_idc: square
    writer.write_bit(false); // overscan_info_present_flag
    writer.write_bit(true); // video_signal_type_present_flag
    writer.write_bits(5, 3); // video_format: unspecified
    writer.write_bit(false); // video_full_range_flag
    writer.write_bit(true); // colour_description_present_flag
    (0..3).for_each(|_| writer.write_bits(BT709.into(), 8)); // primaries, transfer, matrix
    writer.write_bit(false); // chroma_loc_info_present_flag: as is usual, and as `Picture` puts them
    writer.write_bit(false); // timing_info_present_flag: the file tells
    writer.write_bit(false); // nal_hrd_parameters_present_flag
    writer.write_bit(false); // vcl_hrd_parameters_present_flag
    writer.write_bit(false); // pic_struct_present_flag
    writer.write_bit(true); // bitstream_restriction_flag
    writer.write_bit(true); // motion_vectors_over_pic_boundaries_flag
    writer.write_ue(0); // max_bytes_per_pic_denom: no limit
    writer.write_ue(0); // max_bits_per_mb_denom: no limit
    writer.write_ue(16); // log2_max_mv_length_horizontal
    writer.write_ue(16); // log2_max_mv_length_vertical
    writer.write_ue(0); // max_num_reorder_frames
    writer.write_ue(1); // max_dec_frame_buffering
    writer.rbsp_trailing_bits();
    let mut set = header.to_vec();
    emulation_prevent_into(&writer.into_bytes(), &mut set);
    set
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_allow_what_they_are_for() {
        let usual = [
            ([640, 360], 30.0, 30),
            ([1280, 720], 30.0, 31),
            ([1280, 720], 60.0, 32),
            ([1920, 1080], 30.0, 40),
            ([1920, 1080], 60.0, 42),
            ([4096, 2160], 60.0, 52),
            ([7680, 4320], 60.0, 61),
        ];
        for (size, rate, expected) in usual {
            assert_eq!(level(size, rate), Some(expected), "{size:?} at {rate}");
        }
        assert_eq!(level([8192, 4320], 1000.0), Some(62));
        assert_eq!([level([8192, 8192], 1.0), level([16_400, 16], 1.0), level([0, 16], 1.0)], [None; 3]);
    }
}
