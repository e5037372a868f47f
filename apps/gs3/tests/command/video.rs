//! Videos, with a stand-in for `ffmpeg` that keeps what it is given.
#![cfg(unix)]

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Stdio;

use gs3_video::Picture;

use super::{gs3, interrupt, names, png, refused, send_interrupt, stderr};

/// A PATH that holds nothing but an `ffmpeg` with this script.
fn path_with_ffmpeg(folder: &Path, script: &str) -> String {
    let bin = folder.join("bin");
    fs::create_dir(&bin).unwrap();
    let file = bin.join("ffmpeg");
    fs::write(&file, format!("#!/bin/sh\n{script}\n")).unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
    bin.display().to_string()
}

const RENDER: &str = "render demo --size 96x54 --frames 0..3 --out clip.mp4";

#[test]
fn frames_reach_ffmpeg_in_order() {
    let folder = tempfile::tempdir().unwrap();
    // The last argument is the file to write.
    let script = r#"echo "$@" > arguments; for last; do :; done; /bin/cat > "$last""#;
    let path = path_with_ffmpeg(folder.path(), script);
    let output = gs3(folder.path(), RENDER).env("PATH", path).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let video = fs::read(folder.path().join("clip.mp4")).unwrap();
    let frames = names(&folder.path().join("clip"));
    assert_eq!(frames.len(), 7);
    let picture = |name: &String| {
        let (width, height, rgb) = png(&folder.path().join("clip").join(name));
        Picture::from_rgb8([width, height], &rgb).unwrap().samples().to_vec()
    };
    let expected: Vec<u8> = frames.iter().flat_map(picture).collect();
    assert!(video == expected, "the raw frames are those of the PNG files, in order");
    let arguments = fs::read_to_string(folder.path().join("arguments")).unwrap();
    assert!(arguments.contains("-s 96x54 -r 60 "), "{arguments}");
    let colours = "-color_range tv -colorspace bt709 -color_primaries bt709 -color_trc bt709";
    assert_eq!(arguments.matches(colours).count(), 2, "of what comes in and what goes out: {arguments}");
    assert_eq!(names(folder.path()), ["arguments", "bin", "clip", "clip.mp4"]);
}

/// How the command says that a video of frames 0 to 6 is made.
const BY_HAND: &str = "ffmpeg -framerate 60 -start_number 0 -i ./clip/frame_%06d.png -frames:v 7 -vf ";

#[test]
fn without_ffmpeg_there_is_a_video_too() {
    let folder = tempfile::tempdir().unwrap();
    let output = gs3(folder.path(), RENDER).env("PATH", "").output().unwrap();
    let said = stderr(&output);
    assert!(output.status.success(), "{said}");
    assert!(said.contains("no ffmpeg on PATH: clip.mp4 is encoded by gs3 itself"), "{said}");
    assert_eq!(names(folder.path()), ["clip", "clip.mp4"]);
    assert_eq!(names(&folder.path().join("clip")).len(), 7);
    let video = fs::read(folder.path().join("clip.mp4")).unwrap();
    // What is in it is the tests' of its crate.
    assert_eq!((&video[4..8], video.windows(4).filter(|w| w == b"avc1").count()), (&b"ftyp"[..], 2));
}

/// Writes path.json: two cameras near each other, `fps` a second.
fn write_path(folder: &Path, fps: u32) {
    let camera = |x: f64| {
        format!(r#"{{"camera_to_world": [1,0,0,{x}, 0,1,0,0, 0,0,1,5, 0,0,0,1], "fov": 50, "aspect": 1.8}}"#)
    };
    let (first, second) = (camera(0.0), camera(0.1));
    let size = r#""render_height": 54, "render_width": 96"#;
    fs::write(
        folder.join("path.json"),
        format!(r#"{{"fps": {fps}, {size}, "camera_path": [{first}, {second}]}}"#),
    )
    .unwrap();
}

#[test]
fn a_rate_that_screens_do_not_show_is_told() {
    let folder = tempfile::tempdir().unwrap();
    write_path(folder.path(), 30);
    for (options, told) in [
        ("--out clip.mp4", true),
        ("--in-between 1 --out clip.mp4", false),
        ("--mode native --out native.mp4", false),
        ("--out frames", false),
    ] {
        fs::remove_dir_all(folder.path().join("clip")).ok();
        let render = format!("render demo --path path.json {options}");
        let output = gs3(folder.path(), &render).env("PATH", "").output().unwrap();
        let said = stderr(&output);
        assert!(output.status.success(), "{said}");
        let line =
            "clip.mp4 has 90 frames per second, and most screens show 60; with --in-between 1 it has 60\n";
        assert_eq!((said.contains(line), said.contains("most screens")), (told, told), "{options}: {said}");
    }
}

#[test]
fn a_video_that_cannot_be_made_costs_no_frame() {
    let folder = tempfile::tempdir().unwrap();
    // A frame rate that no video of ours has.
    write_path(folder.path(), 4000);
    let render = "render demo --path path.json --mode native --out clip.mp4";
    let output = gs3(folder.path(), render).env("PATH", "").output().unwrap();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    let reason = "error: clip.mp4: the video cannot be written: frame rate: expected more than 0 and at most 1000 frames per \
                  second, found 4000; the frames are in clip, and ffmpeg -framerate 4000 ";
    assert!(said.contains(reason), "{said}");
    assert_eq!(names(folder.path()), ["clip", "path.json"]);
    assert_eq!(names(&folder.path().join("clip")).len(), 2);
}

/// What is typed by hand, and what the command does by itself, with the real one: both tell players the same colours, and
/// these are those of the frames.
#[test]
fn videos_show_the_colours_of_the_frames() {
    let run = |program: &str, arguments: &[&str]| {
        let output = std::process::Command::new(program).args(arguments).output();
        let output = output.ok().filter(|output| output.status.success())?;
        Some(output.stdout)
    };
    if run("ffmpeg", &["-version"]).is_none() || run("ffprobe", &["-version"]).is_none() {
        println!("skipped: there is no ffmpeg");
        return;
    }
    for (size, background) in
        [("97x55", [0.2, 0.6, 0.3]), ("128x72", [0.0, 1.0, 0.0]), ("128x72", [1.0, 0.0, 0.0])]
    {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let camera = r#"[{"width": 96, "height": 54, "position": [0, 0, -500], "fx": 50, "fy": 50,
            "rotation": [[1, 0, 0], [0, -1, 0], [0, 0, -1]]}]"#;
        fs::write(at.join("away.json"), camera).unwrap();
        let [r, g, b] = background;
        let render = format!(
            "render demo --path away.json --size {size} --smooth 3 --mode native --background {r},{g},{b} --out"
        );
        let with = gs3(at, &format!("{render} ffmpeg.mp4")).output().unwrap();
        assert!(with.status.success(), "{}", stderr(&with));
        let without = gs3(at, &format!("{render} own.mp4")).env("PATH", "").output().unwrap();
        assert!(without.status.success(), "{}", stderr(&without));
        // The command tells how to make it by hand where an ffmpeg fails.
        let bin = path_with_ffmpeg(at, "exit 1");
        let failed = gs3(at, &format!("{render} hand.mp4")).env("PATH", bin).output().unwrap();
        let said = stderr(&failed);
        let by_hand =
            &said[said.find("and ffmpeg ").unwrap() + 4..said.find(" makes a video of them").unwrap()];
        let typed = std::process::Command::new("sh").args(["-c", by_hand]).current_dir(at).output().unwrap();
        assert!(typed.status.success(), "{by_hand}: {}", stderr(&typed));
        let (width, height, frame) = png(&at.join("own/frame_000000.png"));
        for name in ["ffmpeg.mp4", "own.mp4", "hand.mp4"] {
            let file = at.join(name).display().to_string();
            let entries =
                "stream=width,height,color_range,color_space,color_transfer,color_primaries,nb_frames";
            let facts =
                run("ffprobe", &["-v", "error", "-show_entries", entries, "-of", "csv=p=0", &file]).unwrap();
            let [w, h] = [width, height].map(|side| side.next_multiple_of(2));
            let expected = format!("{w},{h},tv,bt709,bt709,bt709,3\n");
            assert_eq!(String::from_utf8(facts).unwrap(), expected, "{name}");
            let filter = "scale=flags=accurate_rnd+full_chroma_int+full_chroma_inp";
            let decode =
                ["-v", "error", "-i", &file, "-vf", filter, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"];
            let pixels = run("ffmpeg", &decode).unwrap();
            assert_eq!(pixels.len() as u32, 3 * 3 * w * h);
            // The last column and row of odd sizes are those beside them, not black.
            for pixel in pixels.chunks_exact(3) {
                let off = pixel.iter().zip(&frame).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
                assert!(off <= 2, "{name}, {size}: {pixel:?} of {:?}", &frame[..3]);
            }
        }
    }
}

/// Shell: the last argument, the file that `ffmpeg` writes.
const LAST: &str = "for last; do :; done;";

#[test]
fn a_failing_ffmpeg_is_quoted_and_costs_no_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = path_with_ffmpeg(
        folder.path(),
        &format!("{LAST} echo 'Unknown encoder libx264' >&2; : > \"$last\"; exit 1"),
    );
    let run = || gs3(folder.path(), &format!("{RENDER} --json r.json")).env("PATH", &path).output().unwrap();
    let output = run();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    let failed = "error: clip.mp4: ffmpeg failed: Unknown encoder libx264; the frames are in clip, and ";
    assert!(said.lines().last().unwrap().starts_with(&format!("{failed}{BY_HAND}")), "{said}");
    assert_eq!(names(folder.path()), ["bin", "clip", "r.json"]);
    assert_eq!(names(&folder.path().join("clip")).len(), 7, "all frames are there");

    // A file without the right to be executed is no ffmpeg.
    fs::set_permissions(folder.path().join("bin/ffmpeg"), fs::Permissions::from_mode(0o644)).unwrap();
    fs::remove_dir_all(folder.path().join("clip")).unwrap();
    let output = run();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(said.contains("no ffmpeg on PATH"), "{said}");
    assert_eq!(names(folder.path()), ["bin", "clip", "clip.mp4", "r.json"]);
}

/// It neither takes frames nor ends, for much longer than a second interruption takes.
#[test]
fn a_stuck_ffmpeg_is_ended_by_a_second_interruption() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let path = path_with_ffmpeg(at, &format!("{LAST} : > \"$last\"; echo $$ > pid; exec /bin/sleep 30"));
    let mut command = gs3(at, "render demo --size 320x180 --threads 1 --tier analytic --out clip.mp4");
    let child = command.env("PATH", path).stderr(Stdio::piped()).spawn().unwrap();
    let frames = at.join("clip");
    let id = child.id();
    let output = interrupt(child, || {
        // One frame is more than a pipe holds.
        let is_stuck = at.join("pid").is_file() && frames.is_dir() && !names(&frames).is_empty();
        if is_stuck {
            send_interrupt(id);
            std::thread::sleep(std::time::Duration::from_millis(300));
        }
        is_stuck
    });
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert!(said.ends_with("interrupted at once; all files are whole\n"), "{said}");
    assert_eq!(names(at), ["bin", "clip", "pid"]);
    for name in names(&frames) {
        assert_eq!(png(&frames.join(name)).0, 320);
    }
    let pid = fs::read_to_string(at.join("pid")).unwrap();
    let is_there = std::process::Command::new("kill").args(["-0", pid.trim()]).output().unwrap().status;
    assert!(!is_there.success(), "ffmpeg has ended");
}

#[test]
fn a_link_leads_to_the_video_and_a_pipe_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let script = r#"for last; do :; done; /bin/cat > "$last""#;
    let path = path_with_ffmpeg(at, script);
    fs::create_dir(at.join("far")).unwrap();
    // To a file and to none yet.
    for target in ["far/old", "far/new"] {
        fs::write(at.join("far/old"), "before").unwrap();
        std::os::unix::fs::symlink(target, at.join("clip.mp4")).unwrap();
        let output = gs3(at, RENDER).env("PATH", &path).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        assert_eq!(fs::read_link(at.join("clip.mp4")).unwrap(), Path::new(target));
        assert_eq!(fs::metadata(at.join(target)).unwrap().len(), 7 * 96 * 54 * 3 / 2);
        fs::remove_file(at.join("clip.mp4")).unwrap();
    }
    assert_eq!(names(&at.join("far")), ["new", "old"]);
    assert!(std::process::Command::new("mkfifo").arg(at.join("pipe.mp4")).status().unwrap().success());
    let said = refused(gs3(at, "render no.ply --out pipe.mp4").env("PATH", &path));
    assert_eq!(said, "error: --out: expected a file, found pipe.mp4, a device or a pipe\n");
}

#[test]
fn frames_of_different_sizes_are_no_video() {
    let folder = tempfile::tempdir().unwrap();
    let camera = |width: u32, height: u32| {
        format!(
            r#"{{"width": {width}, "height": {height}, "position": [0, 0, -5], "fx": 50, "fy": 50,
                "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}}"#
        )
    };
    let cameras = format!("[{}, {}, {}]", camera(64, 36), camera(64, 36), camera(80, 45));
    fs::write(folder.path().join("cameras.json"), cameras).unwrap();
    let path = path_with_ffmpeg(folder.path(), "/bin/cat > /dev/null");
    let render = "render demo --path cameras.json --tier analytic --mode native --out";
    let output = gs3(folder.path(), &format!("{render} v.mp4")).env("PATH", &path).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    assert!(
        said.contains("--size") && said.contains("found 64x36 in frame 0 and 80x45 in frame 2"),
        "{said}"
    );
    assert_eq!(names(folder.path()), ["bin", "cameras.json"]);
    // Files may differ, and those before do not.
    for out in ["frames", "v.mp4 --frames 0..2"] {
        let output = gs3(folder.path(), &format!("{render} {out}")).env("PATH", "").output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
    }
}

/// The `ffmpeg` of a command that was killed goes on to the end of its own file; the next command's file is another one.
#[test]
fn a_killed_command_leaves_its_ffmpeg_a_file_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let script = format!(r#"{LAST} echo "$last" >> lasts; /bin/cat > "$last""#);
    let path = path_with_ffmpeg(folder.path(), &script);
    for _ in 0..2 {
        let output = gs3(folder.path(), RENDER).env("PATH", &path).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let lasts = fs::read_to_string(folder.path().join("lasts")).unwrap();
    let lasts: Vec<_> = lasts.lines().collect();
    assert!(lasts.len() == 2 && lasts[0] != lasts[1], "{lasts:?}");
}

#[test]
fn a_name_is_no_option_of_ffmpeg() {
    let folder = tempfile::tempdir().unwrap();
    let script = format!(r#"{LAST} echo "$last" > last; /bin/cat > "$last""#);
    let path = path_with_ffmpeg(folder.path(), &script);
    let render = "render demo --size 16x9 --frames 0..1 --tier analytic --out=-y.mp4";
    let output = gs3(folder.path(), render).env("PATH", path).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let last = fs::read_to_string(folder.path().join("last")).unwrap();
    assert!(last.starts_with("./-y.") && last.ends_with(".mp4.partial\n"), "{last}");
}

#[test]
fn after_an_interruption_it_is_said_how_the_whole_video_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let path = path_with_ffmpeg(folder.path(), "/bin/cat > /dev/null");
    let mut command = gs3(folder.path(), "render demo --size 320x180 --frames 2..240 --out clip.mp4");
    let child = command.env("PATH", path).stderr(Stdio::piped()).spawn().unwrap();
    let frames = folder.path().join("clip");
    let output = interrupt(child, || frames.is_dir() && names(&frames).len() >= 4);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(130), "{said}");
    let names = names(&frames);
    // Frames 4 to 717. The next one to render shows three.
    let left = 2 + names.len() / 3;
    assert_eq!(names[0], "frame_000004.png");
    let rest = format!("To go on: the same command with --frames {left}..240 --out ./clip/, and then, ");
    assert!(said.contains(&rest), "{said}");
    let whole = "ffmpeg -framerate 60 -start_number 4 -i ./clip/frame_%06d.png -frames:v 714 -vf scale=out_color_matrix=bt709:";
    assert!(said.contains(whole) && said.trim_end().ends_with(" ./clip.mp4"), "{said}");
}
