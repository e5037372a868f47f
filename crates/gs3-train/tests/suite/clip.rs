//! Clips: parts of them, files, and what is refused.

use std::fs;

use crate::common::{SCALE, clip};
use gs3_train::clip::{from_unorm, to_unorm};
use gs3_train::{Clip, ClipError, ClipFile, ClipWindow, Network};
use half::f16;

const LR: [usize; 2] = [7, 9];

fn window() -> ClipWindow {
    ClipWindow { frames: 1..3, rows: 2..6, columns: 3..8 }
}

#[test]
fn a_file_gives_what_was_written_whole_and_in_parts() {
    let folder = tempfile::tempdir().unwrap();
    for network in Network::ALL {
        let clip = clip(network, 4, LR, 1);
        // Not assert_eq: its output would be too long to read.
        assert!(Clip::from_bytes(&clip.to_bytes().unwrap()).unwrap() == clip);
        let path = folder.path().join("a.clip");
        clip.save(&path).unwrap();
        let file = ClipFile::open(&path).unwrap();
        assert_eq!((file.network(), file.scene(), file.scale()), (network, "waves 1", SCALE));
        assert_eq!((file.frames(), file.lr()), (4, LR));
        assert!(file.read(&window()).unwrap() == clip.crop(&window()).unwrap());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "something unfinished was left");
    }
}

#[test]
fn files_are_written_whole_or_not_at_all_and_links_stay() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let clip = clip(Network::SuperSample, 1, LR, 1);
    fs::create_dir(at("folder.clip")).unwrap();
    assert!(matches!(clip.save(&at("folder.clip")), Err(ClipError::File { .. })));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "something unfinished was left");
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("file.clip", at("link.clip")).unwrap();
        clip.save(&at("link.clip")).unwrap();
        assert!(at("link.clip").is_symlink() && ClipFile::open(&at("file.clip")).is_ok());
    }
}

#[test]
fn a_part_holds_the_pixels_of_its_place() {
    let whole = clip(Network::SuperSample, 4, LR, 2);
    let part = whole.crop(&window()).unwrap();
    assert_eq!((part.lr, part.frames.len()), ([4, 5], 2));
    let value = |clip: &Clip, frame: usize, name: &str, x: usize, y: usize, c: usize, factor: usize| {
        let plane = clip.frames[frame].inputs.iter().find(|plane| plane.name == name).unwrap();
        plane.values[(y * clip.lr[1] * factor + x) * plane.channels + c]
    };
    assert_eq!(value(&part, 1, "gradients", 2, 3, 4, 1), value(&whole, 2, "gradients", 5, 5, 4, 1));
    // HR pixel (3, 5) of the part is (3 + 2·3, 5 + 2·2) of the whole.
    assert_eq!(value(&part, 0, "history", 3, 5, 1, 2), value(&whole, 1, "history", 9, 9, 1, 2));
    assert_eq!(part.frames[0].target[(5 * 10 + 3) * 3 + 2], whole.frames[1].target[(9 * 18 + 9) * 3 + 2]);
    // Nothing but validity depends on where a part is cut.
    let again = part.crop(&ClipWindow { frames: 0..2, rows: 0..4, columns: 0..5 }).unwrap();
    assert!(again == part);
}

/// A pixel with a past outside the part has no past there, as at the border of an image.
#[test]
fn what_comes_from_outside_a_part_is_not_valid() {
    let mut whole = clip(Network::SuperSample, 3, LR, 3);
    for frame in &mut whole.frames {
        for plane in frame.inputs.iter_mut().filter(|plane| plane.name == "motion") {
            for [x, y] in plane.values.as_chunks_mut::<2>().0 {
                (*x, *y) = (f16::from_f32(-1.4), f16::from_f32(0.6));
            }
        }
    }
    let part = whole.crop(&window()).unwrap();
    let validity = part.frames[0].inputs.iter().find(|plane| plane.name == "validity").unwrap();
    for (k, valid) in validity.values.iter().enumerate() {
        let (x, y) = (k % 5, k / 5);
        // x − 1.4 ≥ −½ from 1 on; y + 0.6 ≤ 3½ up to 2.
        assert_eq!(valid.to_f32(), if x >= 1 && y <= 2 { 1.0 } else { 0.0 }, "({x}, {y})");
    }
}

#[test]
fn sixteen_bits_hold_a_colour() {
    for k in 0..=10_000 {
        let value = k as f32 / 10_000.0;
        assert!((from_unorm(to_unorm(value)) - value).abs() <= 7.7e-6, "{value}");
    }
    assert_eq!([-1.0, 2.0, f32::NAN].map(to_unorm), [0, u16::MAX, 0]);
}

#[test]
fn clips_that_are_not_whole_are_refused() {
    let broken = |change: &dyn Fn(&mut Clip)| {
        let mut clip = clip(Network::SuperSample, 2, LR, 4);
        change(&mut clip);
        let refused = clip.check().unwrap_err();
        assert!(clip.to_bytes().is_err() && clip.crop(&window()).is_err(), "{refused}");
        refused.to_string()
    };
    let contains = |text: String, part: &str| assert!(text.contains(part), "{text}");
    contains(broken(&|clip| clip.frames.clear()), "at least one frame, found none");
    contains(broken(&|clip| drop(clip.frames[1].inputs.pop())), "frame 1, validity: expected 7×9×1, found 0");
    contains(broken(&|clip| clip.frames[1].inputs.swap(0, 1)), "frame 1: expected inputs in the order");
    contains(
        broken(&|clip| clip.frames[0].target.truncate(755)),
        "frame 0, target: expected 756 numbers, found 755",
    );
    contains(
        broken(&|clip| clip.frames[0].inputs[0].values.truncate(9)),
        "frame 0, history: expected 14×18×4",
    );
    contains(broken(&|clip| clip.frames[0].inputs[0].name = "hidden".to_owned()), "history: expected");
    contains(broken(&|clip| clip.scale = 99), "scale: expected 1 to 8, found 99");
    contains(broken(&|clip| clip.lr = [usize::MAX, 9]), "image: expected 1 to");
}

#[test]
fn parts_beyond_a_clip_are_refused() {
    let clip = clip(Network::SuperSample, 4, LR, 5);
    let all = ClipWindow { frames: 0..4, rows: 0..7, columns: 0..9 };
    clip.crop(&all).unwrap();
    for wrong in [
        ClipWindow { frames: 0..5, ..all.clone() },
        ClipWindow { rows: 0..8, ..all.clone() },
        ClipWindow { columns: 9..10, ..all.clone() },
        ClipWindow { columns: 3..3, ..all.clone() },
    ] {
        assert!(matches!(clip.crop(&wrong), Err(ClipError::Window { .. })), "{wrong:?}");
    }
}

#[test]
fn damaged_files_are_refused() {
    let bytes = clip(Network::Interpolate, 2, LR, 6).to_bytes().unwrap();
    let header = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    for length in (0..header).step_by(7).chain([header, header + 100, bytes.len() - 1]) {
        assert!(Clip::from_bytes(&bytes[..length]).is_err(), "{length} bytes were taken for a clip");
    }
    let mut longer = bytes.clone();
    longer.push(0);
    assert!(Clip::from_bytes(&longer).is_err());
    let changed = |from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
        let mut bytes = bytes.clone();
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        Clip::from_bytes(&bytes).unwrap_err().to_string()
    };
    let contains = |text: String, part: &str| assert!(text.contains(part), "{text}");
    contains(changed("\"clip\":\"1\"", "\"clip\":\"2\""), "header, clip: expected 1, found 2");
    contains(
        changed("\"interpolate\"", "\"interpolata\""),
        "expected super_sample or interpolate, found interpolata",
    );
    contains(
        changed("inputs/share", "inputs/shore"),
        "inputs/share: expected F16 [2, 14, 18, 1], found none",
    );
    contains(changed("\"scale\":\"2\"", "\"scale\":\"x\""), "header, scale: expected a number, found x");
    contains(
        changed("\"scale\":\"2\"", "\"scale\":\"7\""),
        "target: expected U16 [frames, 7·height, 7·width, 3], found [2, 14, 18, 3]",
    );
}
