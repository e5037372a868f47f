//! Videos, read back: by a reader of the file's boxes written for these tests with a decoder in Rust, and by ffmpeg where
//! there is one.

#![allow(clippy::unwrap_used, reason = "tests")]

mod boxes;

use std::io::Cursor;
use std::process::Command;

use boxes::Clip;
use gs3_video::{VideoError, VideoWriter};
use rusty_h264_decoder::Decoder;

/// Colours of the patches of a frame: corners of the cube, greys, and some between.
const COLOURS: [[u8; 3]; 12] = [
    [255, 0, 0],
    [0, 255, 0],
    [0, 0, 255],
    [255, 255, 0],
    [255, 255, 255],
    [0, 0, 0],
    [128, 128, 128],
    [51, 153, 77],
    [200, 120, 60],
    [20, 40, 160],
    [250, 5, 250],
    [7, 7, 7],
];
const PATCHES: [usize; 2] = [4, 3];

/// Frame `shift` of patches, each colour one patch further from frame to frame.
fn patches([width, height]: [u32; 2], shift: usize) -> Vec<u8> {
    let [width, height] = [width, height].map(|side| side as usize);
    let pixel = |x: usize, y: usize| {
        let patch = y * PATCHES[1] / height * PATCHES[0] + x * PATCHES[0] / width;
        COLOURS[(patch + shift) % COLOURS.len()]
    };
    (0..height).flat_map(|y| (0..width).flat_map(move |x| pixel(x, y))).collect()
}

/// A video of `count` frames.
fn clip(size: [u32; 2], rate: f64, count: usize, frame: impl Fn(usize) -> Vec<u8>) -> Vec<u8> {
    let mut writer = VideoWriter::new(Cursor::new(Vec::new()), size, rate, count).unwrap();
    (0..count).for_each(|k| writer.write(&frame(k)).unwrap());
    writer.finish().unwrap().into_inner()
}

/// The colour of a decoded pixel, as BT.709 with limited range defines it.
fn rgb(y: u8, cb: u8, cr: u8) -> [f64; 3] {
    let y = (f64::from(y) - 16.0) / 219.0;
    let [cb, cr] = [cb, cr].map(|c| (f64::from(c) - 128.0) / 224.0);
    [y + 1.5748 * cr, y - 0.187_324_272_93 * cb - 0.468_124_272_93 * cr, y + 1.8556 * cb].map(|v| 255.0 * v)
}

/// Checks the mean of the inside of every patch of frame `k`; `at` gives the frame's pixels.
fn check_patches(size: [u32; 2], k: usize, at: impl Fn(usize, usize) -> [f64; 3]) {
    let [width, height] = size.map(|side| side as usize);
    // Colour samples reach a pixel across the border of a patch, and deblocking filters three.
    const BORDER: usize = 8;
    for patch in 0..COLOURS.len() {
        let [column, row] = [patch % PATCHES[0], patch / PATCHES[0]];
        let across = |i: usize, side: usize, of: usize| {
            (i * side).div_ceil(of) + BORDER..((i + 1) * side).div_ceil(of) - BORDER
        };
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for y in across(row, height, PATCHES[1]) {
            for x in across(column, width, PATCHES[0]) {
                at(x, y).into_iter().zip(&mut sum).for_each(|(value, sum)| *sum += value);
                count += 1.0;
            }
        }
        let colour = COLOURS[(patch + k) % COLOURS.len()];
        for c in 0..3 {
            let mean = sum[c] / count;
            let off = (mean - f64::from(colour[c])).abs();
            assert!(off <= 2.0, "frame {k}, colour {colour:?}: channel {c} is {mean:.2}");
        }
    }
}

/// The frames of a video, decoded in Rust.
fn decoded(clip: &Clip) -> Vec<rusty_h264_common::YuvFrame> {
    Decoder::new().decode_stream(&clip.annex_b()).unwrap()
}

const ODD: [u32; 2] = [401, 203];

#[test]
fn colours_sizes_and_times_come_back() {
    for (size, rate) in [(ODD, 29.97), ([640, 360], 60.0)] {
        let bytes = clip(size, rate, 9, |k| patches(size, k));
        let clip = Clip::read(&bytes);
        let even = size.map(|side| side.next_multiple_of(2));
        assert_eq!((clip.size, clip.frames.len()), (even, 9));
        assert!((clip.rate / rate - 1.0).abs() < 1e-9, "{}", clip.rate);
        assert_eq!(clip.colours, *b"nclx\0\x01\0\x01\0\x01\0", "BT.709, limited range");
        assert!(clip.is_index_first && clip.frames[0].1, "pages can show it while it loads");
        let frames = decoded(&clip);
        assert_eq!(frames.len(), 9);
        for (k, frame) in frames.iter().enumerate() {
            assert_eq!([frame.width, frame.height], even.map(|side| side as usize));
            check_patches(size, k, |x, y| {
                let chroma = y / 2 * (frame.width / 2) + x / 2;
                rgb(frame.y[y * frame.width + x], frame.u[chroma], frame.v[chroma])
            });
        }
    }
}

/// A picture with fine detail that moves by whole pixels.
fn moving([width, height]: [u32; 2], k: usize) -> Vec<u8> {
    let value = |x: u32, y: u32| {
        let (x, y) = (f64::from(x) + 3.0 * k as f64, f64::from(y) + k as f64);
        let wave = |a: f64, b: f64| 0.5 + 0.25 * (x / a).sin() + 0.2 * (y / b).cos();
        let fine = 0.08 * ((x * 0.9).sin() * (y * 1.1).cos());
        [wave(23.0, 17.0) + fine, wave(11.0, 31.0) - fine, wave(47.0, 9.0)].map(|v| (255.0 * v) as u8)
    };
    (0..height).flat_map(|y| (0..width).flat_map(move |x| value(x, y))).collect()
}

#[test]
fn detail_survives_and_motion_costs_little() {
    let size = [320, 192];
    let bytes = clip(size, 30.0, 12, |k| moving(size, k));
    let clip = Clip::read(&bytes);
    for (k, frame) in decoded(&clip).iter().enumerate() {
        let source = gs3_video::Picture::from_rgb8(size, &moving(size, k)).unwrap();
        let squares = source.planes()[0].iter().zip(&frame.y);
        let squares = squares.map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2));
        let psnr = 10.0 * (255.0_f64.powi(2) / (squares.sum::<f64>() / frame.y.len() as f64)).log10();
        assert!(psnr > 43.0, "frame {k}: luma at {psnr:.2} dB");
    }
    let (key, rest) = (clip.frames[0].0.len(), &clip.frames[1..]);
    let others = rest.iter().map(|(frame, _)| frame.len()).sum::<usize>() / rest.len();
    assert!(2 * others < key, "a key frame of {key} bytes, others of {others}");
}

#[test]
fn key_frames_come_every_two_seconds_and_the_index_has_room() {
    let size = [32, 16];
    for (count, room) in [(13, 13), (13, 13 * 100), (1, 1), (200, 0)] {
        let mut writer = VideoWriter::new(Cursor::new(Vec::new()), size, 2.5, room).unwrap();
        (0..count).for_each(|k| writer.write(&patches(size, k)).unwrap());
        let bytes = writer.finish().unwrap().into_inner();
        let clip = Clip::read(&bytes);
        let keys: Vec<usize> = (0..clip.frames.len()).filter(|k| clip.frames[*k].1).collect();
        assert_eq!(keys, (0..count).step_by(5).collect::<Vec<_>>());
        assert_eq!(clip.is_index_first, room >= count, "{count} frames, room for {room}");
        assert_eq!(decoded(&clip).len(), count);
    }
}

#[test]
fn what_is_no_video_is_refused() {
    let new = |size, rate| VideoWriter::new(Cursor::new(Vec::new()), size, rate, 1);
    let size =
        |actual| matches!(new(actual, 30.0), Err(VideoError::Size { actual: found }) if found == actual);
    assert!(size([0, 16]) && size([20_000, 16]) && size([8192, 8192]));
    for rate in [0.0, -1.0, f64::NAN, f64::INFINITY, 1001.0] {
        assert!(matches!(new([16, 16], rate), Err(VideoError::Rate { .. })), "{rate}");
    }
    let mut writer = new([16, 16], 30.0).unwrap();
    let error = writer.write(&[0; 12]).unwrap_err();
    assert_eq!(error.to_string(), "frame: expected 768 bytes, 3 for each of 16x16 pixels, found 12");
    assert_eq!(writer.finish().unwrap_err().to_string(), "H.264: expected at least one frame, found none");
}

/// `program` with `arguments`, if it is there.
fn output(program: &str, arguments: &[&str]) -> Option<Vec<u8>> {
    let output = match Command::new(program).args(arguments).output() {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return None,
        output => output.unwrap(),
    };
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && said.is_empty(), "{program}: {said}");
    Some(output.stdout)
}

#[test]
fn ffmpeg_reads_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("clip.mp4");
    let path = file.to_str().unwrap();
    std::fs::write(&file, clip(ODD, 30_000.0 / 1001.0, 70, |k| patches(ODD, k))).unwrap();
    let arguments = ["-v", "error", "-count_frames", "-show_streams", path];
    let Some(streams) = output("ffprobe", &arguments) else {
        println!("skipped: there is no ffprobe");
        return;
    };
    let streams = String::from_utf8(streams).unwrap();
    for fact in [
        "codec_name=h264",
        "width=402",
        "height=204",
        "pix_fmt=yuv420p",
        "color_range=tv",
        "color_space=bt709",
        "color_transfer=bt709",
        "color_primaries=bt709",
        "r_frame_rate=30000/1001",
        "avg_frame_rate=30000/1001",
        "sample_aspect_ratio=1:1",
        "has_b_frames=0",
        "nb_frames=70",
        "nb_read_frames=70",
        "duration=2.335667",
    ] {
        assert!(streams.lines().any(|line| line == fact), "{fact} of\n{streams}");
    }
    // Its decoder, its reading of the tags, and its conversion.
    let filter = "scale=flags=accurate_rnd+full_chroma_int+full_chroma_inp";
    let arguments = ["-v", "error", "-i", path, "-vf", filter, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"];
    let Some(pixels) = output("ffmpeg", &arguments) else {
        println!("skipped: there is no ffmpeg");
        return;
    };
    let frames = pixels.chunks_exact(3 * 402 * 204);
    assert_eq!(frames.len(), 70);
    for (k, frame) in frames.enumerate() {
        check_patches(ODD, k, |x, y| [0, 1, 2].map(|c| f64::from(frame[3 * (402 * y + x) + c])));
    }
}
