//! C and C++ programs, built by the system's compilers against the installed library, run plain and under valgrind.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use std::{env, fs};

use gs3::scene::{Camera, Gaussians, Image, OpacityMode, Scene, format, gaussians, orbit};
use gs3::{
    Backend, Dilation, Kriging, Mode, Networks, PipelineSettings, Quality, Refine, Sampling, Scale, Session,
    SessionSettings, Tier,
};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

/// Where cargo lets tests write.
const FOLDER: &str = env!("CARGO_TARGET_TMPDIR");

/// What `command` gives, if there is such a program; its failure is one of the test.
fn run(command: &mut Command) -> Option<Output> {
    match command.output() {
        Ok(output) => {
            let [out, err] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text));
            assert!(output.status.success(), "{command:?}: {}\n{out}\n{err}", output.status);
            Some(output)
        }
        Err(error) => {
            println!("skipped: {}: {error}", command.get_program().display());
            None
        }
    }
}

/// The library that cargo built for this test, installed.
fn prefix() -> &'static Path {
    static PREFIX: OnceLock<PathBuf> = OnceLock::new();
    PREFIX.get_or_init(|| {
        let prefix = Path::new(FOLDER).join("gs3-c/prefix");
        let own = env::current_exe().expect("a path");
        let built = own.parent().expect("a folder");
        let mut cargo = Command::new(env!("CARGO"));
        cargo.args(["run", "--quiet", "--package", "xtask", "--", "install-c"]).arg(&prefix);
        run(cargo.arg("--from").arg(built).current_dir(ROOT)).expect("cargo");
        prefix
    })
}

/// What pkg-config tells of the installed library, or what it would where it is not installed itself.
fn flags(is_static: bool) -> Vec<String> {
    let mut command = Command::new("pkg-config");
    command.args(["--cflags", "--libs", "gs3"]).args(is_static.then_some("--static"));
    command.env("PKG_CONFIG_PATH", prefix().join("lib/pkgconfig"));
    let text = match run(&mut command) {
        Some(output) => String::from_utf8(output.stdout).expect("UTF-8"),
        None => {
            let rest = if is_static { "-lpthread -lm -ldl" } else { "" };
            format!("-I{0}/include -L{0}/lib -lgs3 {rest}", prefix().display())
        }
    };
    let flags = text.split_whitespace().map(str::to_owned);
    // Linkers take the shared library where there are both.
    flags.map(|flag| if is_static { flag.replace("-lgs3", "-l:libgs3.a") } else { flag }).collect()
}

/// Builds the program of `source`, a path in this crate, with `compiler`; none where there is no compiler.
fn build(compiler: &str, standard: &str, source: &str, is_static: bool) -> Option<PathBuf> {
    let source = Path::new(ROOT).join(source);
    let program = Path::new(FOLDER).join("gs3-c").join(source.file_stem().expect("a name"));
    let mut command = Command::new(compiler);
    command.args([standard, "-O1", "-g", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]);
    command.arg(&source).arg("-o").arg(&program).args(flags(is_static)).arg("-lm");
    run(&mut command).map(|_| program)
}

/// Runs `program` with `arguments`, and gives what it says.
fn run_program(program: &Path, arguments: &[&OsStr]) -> String {
    let mut command = Command::new(program);
    command.args(arguments).env("LD_LIBRARY_PATH", prefix().join("lib"));
    let text = String::from_utf8(run(&mut command).expect("a program").stdout).expect("UTF-8");
    assert!(text.ends_with(" checks passed\n"), "{text}");
    text
}

/// Runs `program` plain and under valgrind, each with a folder of its own after `arguments`, and gives the first folder.
fn check(program: &Path, arguments: &[&OsStr]) -> PathBuf {
    let folder = |way: &str| {
        let folder = Path::new(FOLDER).join("gs3-c").join(way).join(program.file_name().expect("a name"));
        fs::create_dir_all(&folder).expect("a folder");
        folder
    };
    let [plain, checked] = ["plain", "valgrind"].map(folder);
    let passed = run_program(program, &[arguments, &[plain.as_os_str()]].concat());
    let mut command = Command::new("valgrind");
    // Threads and tables of the standard library stay reachable until the end.
    command.args(["--quiet", "--leak-check=full", "--errors-for-leak-kinds=definite,indirect"]);
    command.args(["--show-leak-kinds=definite,indirect", "--error-exitcode=9"]);
    command.arg(program).args(arguments).arg(&checked).env("LD_LIBRARY_PATH", prefix().join("lib"));
    if let Some(output) = run(&mut command) {
        assert_eq!(String::from_utf8_lossy(&output.stdout), passed);
    }
    plain
}

/// Numbers from 0 to 1 that are the same everywhere.
fn noise() -> impl FnMut() -> f32 {
    let mut state = 1_u64;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1_u64 << 24) as f32
    }
}

/// 300 Gaussians of degree 1 about the origin.
fn some_gaussians() -> Gaussians {
    let mut noise = noise();
    let mut some = Gaussians::zeroed(300, 1);
    for i in 0..some.len() {
        some.means.iter_mut().for_each(|plane| plane[i] = 2.0 * noise() - 1.0);
        some.scales.iter_mut().for_each(|plane| plane[i] = 0.03 + 0.12 * noise());
        some.rotations.iter_mut().for_each(|plane| plane[i] = noise() - 0.4);
        some.opacities[i] = 0.3 + 0.6 * noise();
    }
    some.sh.iter_mut().for_each(|v| *v = noise() - 0.5);
    some
}

/// A camera of the orbit that the C programs see a scene by, as it comes back from C.
fn orbit_camera(scene: &Scene, frame: usize) -> Camera {
    let camera = orbit::around(scene, 240, 64, 48).expect("a path").cameras()[frame];
    Camera::new(camera.view_from_world(), camera.intrinsics()).expect("a camera")
}

/// The library's own renderer.
fn session(scene: &Scene, pipeline: PipelineSettings) -> Session {
    let settings = SessionSettings { pipeline, backend: Backend::Cpu, ..SessionSettings::default() };
    Session::new(scene.clone(), settings).expect("a session")
}

/// The bytes of the first `channels` channels of `image`, and of the others as 1.
fn floats(image: &Image, channels: usize) -> Vec<u8> {
    let pixel = |[r, g, b, _]: &[f32; 4]| [*r, *g, *b, 1.0];
    let numbers = image.pixels().iter().flat_map(|p| pixel(p).into_iter().take(channels));
    numbers.flat_map(f32::to_ne_bytes).collect()
}

fn assert_same(folder: &Path, name: &str, expected: &[u8]) {
    let found = fs::read(folder.join(name)).expect(name);
    assert_eq!(found.len(), expected.len(), "{name}");
    let difference = found.iter().zip(expected).position(|(found, expected)| found != expected);
    assert_eq!(difference, None, "{name}: the byte at that place differs");
}

/// The scene of all programs, as a file and as it is read again.
fn scene() -> &'static (PathBuf, Scene) {
    static SCENE: OnceLock<(PathBuf, Scene)> = OnceLock::new();
    SCENE.get_or_init(|| {
        let file = prefix().with_file_name("scene.ply");
        let made = Scene::new(some_gaussians(), OpacityMode::Default).expect("a scene");
        format::save(&made, &file).expect("a file");
        let scene = format::load(&file, &format::LoadOptions::default(), &|_| {}).expect("a scene");
        (file, scene)
    })
}

#[test]
fn frames_in_c_are_those_of_the_library() {
    let Some(program) = build("cc", "-std=c99", "tests/frames.c", false) else { return };
    let (file, scene) = scene();
    let arrays = some_gaussians();
    let numbers = file.with_file_name("arrays.bin");
    let count = arrays.len();
    let interleaved = |planes: &[Vec<f32>]| {
        (0..count).flat_map(|i| planes.iter().map(move |plane| plane[i])).collect::<Vec<f32>>()
    };
    let parts = [
        interleaved(&arrays.means),
        interleaved(&arrays.scales),
        interleaved(&arrays.rotations),
        arrays.opacities.clone(),
        arrays.sh.clone(),
    ];
    assert_eq!(parts[4].len(), count * 3 * gaussians::sh_coefficient_count(1));
    let bytes: Vec<u8> = parts.concat().into_iter().flat_map(f32::to_ne_bytes).collect();
    fs::write(&numbers, bytes).expect("a file");
    let made = check(&program, &[file.as_os_str(), numbers.as_os_str()]);

    let settings = PipelineSettings {
        mode: Mode::Full,
        scale: Scale::Fixed(2),
        in_between: 2,
        background: [0.1, 0.2, 0.3],
        ..PipelineSettings::default()
    };
    let mut full = session(scene, settings);
    for frame in 0..5 {
        let shown = full.render(&orbit_camera(scene, frame)).expect("a frame");
        assert_same(&made, &format!("full_{frame}.rgba"), &floats(shown.current, 4));
        for (k, between) in shown.in_between.into_iter().flatten().enumerate() {
            assert_same(&made, &format!("between_{frame}_{k}.rgb"), &floats(between, 3));
        }
    }
    let plain =
        PipelineSettings { mode: Mode::SuperSample, scale: Scale::Fixed(2), ..PipelineSettings::default() };
    let of_c = [
        PipelineSettings { scale: Scale::Fixed(4), refine: Refine::Off, ..plain },
        PipelineSettings { kriging: Kriging::On, quality: Quality::High, overscan: true, ..plain },
        PipelineSettings { refine: Refine::Share(0.2), sampling: Sampling::Centered, ..plain },
        PipelineSettings { mode: Mode::Bicubic, dilation: Dilation::Kerbl, ..plain },
        PipelineSettings {
            scale: Scale::Fixed(3),
            dilation: Dilation::Value(0.05),
            kriging: Kriging::Fine,
            ..plain
        },
    ];
    for (k, settings) in of_c.into_iter().enumerate() {
        let mut session = session(scene, settings);
        if k == 0 {
            let networks =
                Networks { interpolate: None, ..Networks::shipped(4, Tier::Fast).expect("weights") };
            session.set_pipeline(settings, &networks).expect("networks");
        }
        for frame in 0..3 {
            session.render(&orbit_camera(scene, frame)).expect("a frame");
        }
        assert_same(&made, &format!("settings_{k}.rgb8"), &session.pipeline().last_image().to_rgb8());
    }
    let native = PipelineSettings { mode: Mode::Native, ..PipelineSettings::default() };
    let image = session(scene, native).render(&orbit_camera(scene, 7)).expect("a frame").current.clone();
    assert_same(&made, "native.rgb8", &image.to_rgb8());
    let byte = |v: f32| (v * 255.0 + 0.5) as u8;
    let rgba: Vec<u8> = image.pixels().iter().flat_map(|pixel| pixel.map(byte)).collect();
    assert_same(&made, "native.rgba8", &rgba);
    // Opacities differ, so that the fourth channel says something.
    assert!(rgba.chunks(4).any(|pixel| pixel[3] == 255) || rgba.chunks(4).any(|pixel| pixel[3] > 128));
    assert!(rgba.chunks(4).any(|pixel| pixel[3] < 64));
    let of_arrays = Scene::new(arrays, OpacityMode::Default).expect("a scene");
    let near = orbit::near_plane(&of_arrays);
    let of_arrays = of_arrays.with_near(near);
    let image =
        session(&of_arrays, native).render(&orbit_camera(&of_arrays, 7)).expect("a frame").current.clone();
    assert_same(&made, "arrays.rgb8", &image.to_rgb8());
}

#[test]
fn renderers_in_c_refuse_and_go_on() {
    let Some(program) = build("cc", "-std=c99", "tests/refusals.c", false) else { return };
    check(&program, &[scene().0.as_os_str()]);
}

#[test]
fn the_reconstructor_in_c_reaches_the_image() {
    if let Some(program) = build("cc", "-std=c99", "tests/reconstruct.c", false) {
        check(&program, &[]);
    }
}

#[test]
fn threads_in_cpp_get_the_same_frames_or_are_refused() {
    if let Some(program) = build("c++", "-std=c++17", "tests/threads.cpp", true) {
        check(&program, &[scene().0.as_os_str()]);
    }
}

/// Plain alone: drivers have leaks of their own.
#[test]
fn a_gpu_renders_for_c() {
    let Some(program) = build("cc", "-std=c99", "tests/gpu.c", false) else { return };
    let text = run_program(&program, &[scene().0.as_os_str()]);
    print!("{text}");
}

#[test]
fn the_example_of_the_documents_renders_an_orbit() {
    let read = |path: &str| fs::read_to_string(Path::new(ROOT).join(path)).expect(path);
    assert!(
        read("../../docs/c.md").contains(&format!("\n```c\n{}```\n", read("examples/render.c"))),
        "docs/c.md: expected the text of bindings/c/examples/render.c"
    );
    let Some(program) = build("cc", "-std=c99", "examples/render.c", false) else { return };
    let folder = prefix().with_file_name("orbit");
    fs::create_dir_all(&folder).expect("a folder");
    let mut command = Command::new(&program);
    command.arg(&scene().0).arg(&folder).arg("3").env("LD_LIBRARY_PATH", prefix().join("lib"));
    run(&mut command).expect("a program");
    let frames = [0, 1, 2].map(|k| fs::read(folder.join(format!("frame_00{k}.ppm"))).expect("a frame"));
    for frame in &frames {
        let pixels = frame.strip_prefix(b"P6 320 180 255\n").expect("a PPM");
        assert_eq!(pixels.len(), 320 * 180 * 3);
        assert!(pixels.iter().any(|byte| *byte > 100));
    }
    // From a third of the way round the scene looks otherwise.
    let difference: u64 = frames[0].iter().zip(&frames[1]).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    assert!(difference > 5 * frames[0].len() as u64, "{difference}");
    let mut command = Command::new(&program);
    command.args(["nowhere.ply", "."]).env("LD_LIBRARY_PATH", prefix().join("lib"));
    let output = command.output().expect("a program");
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(text.starts_with("gs3_scene_open: nowhere.ply: cannot be read: "), "{text}");
}
