//! SOG: folder, bundle and streamed.

use std::collections::BTreeMap;

use gs3_scene::OpacityMode;
use gs3_scene::format::{Budget, LoadOptions, Source, Streamed, load_source, streamed};
use image_webp::ColorType;

use crate::handmade::{ply_text, sog, sog_bundle, splat, spz, streamed_sog, webp};
use crate::{assert_close, assert_error, load_bytes, load_folder};

#[test]
fn a_folder_decodes_as_specified() {
    let scene = load_folder("meta.json", &sog(), &LoadOptions::default()).unwrap();
    let gaussians = scene.gaussians();
    assert_eq!((gaussians.len(), gaussians.sh_degree), (4, 1));
    assert_eq!(scene.opacity_mode(), OpacityMode::Antialiased);
    // Log-space bounds −1..1, −2..2, 0..3, inverted by sign · (exp |v| − 1).
    let back = |v: f32| v.signum() * (v.abs().exp() - 1.0);
    assert_close(&gaussians.mean(0), &[back(-1.0), back(-2.0), 0.0], 1e-5);
    assert_close(&gaussians.mean(1), &[back(1.0), back(2.0), back(3.0)], 1e-5);
    let (middle, below) = (32768.0 / 65535.0, 32767.0 / 65535.0);
    assert_close(&gaussians.mean(2), &[back(middle * 2.0 - 1.0), back(below * 4.0 - 2.0), 0.0], 1e-6);
    assert_close(&gaussians.scale(0), &[(-8f32).exp(), (-0.03125f32).exp(), (-7f32).exp()], 1e-6);
    // Tags 252 to 255: w, x, y, z is the largest.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    assert_close(&gaussians.rotation(0), &[1.0, 0.0, 0.0, 0.0], 5e-3);
    assert_close(&gaussians.rotation(1), &[half, half, 0.0, 0.0], 5e-3);
    assert_close(&gaussians.rotation(2), &[0.0, -half, half, 0.0], 5e-3);
    assert_close(&gaussians.rotation(3), &[0.0, 0.0, 0.0, 1.0], 5e-3);
    assert_close(&gaussians.opacities, &[1.0, 0.0, 0.2, 0.4], 1e-6);
    assert_eq!(gaussians.sh_of(0)[..3], [-2.0, 0.0, 1.984_375]);
    let code = |code: u8| f32::from(code) * 0.007_812_5 - 1.0;
    assert_eq!(gaussians.sh_of(2)[3..], [0, 1, 2, 3, 4, 5, 6, 7, 8].map(code));
    assert_eq!(gaussians.sh_of(3)[3..], [128, 129, 130, 131, 132, 133, 134, 135, 255].map(code));
}

#[test]
fn a_bundle_is_the_same() {
    let folder = load_folder("meta.json", &sog(), &LoadOptions::default()).unwrap();
    assert_eq!(load_bytes("b.sog", &sog_bundle()).unwrap(), folder);
}

#[test]
fn a_stream_gives_the_chosen_level_and_the_environment() {
    let files = streamed_sog();
    let chunk = load_folder("meta.json", &sog(), &LoadOptions::default()).unwrap();
    let load = |level_of_detail, environment| {
        let options = LoadOptions { level_of_detail, environment, ..LoadOptions::default() };
        load_folder("lod-meta.json", &files, &options)
    };
    let means = |scene: gs3_scene::Scene| {
        (0..scene.gaussians().len()).map(|i| scene.gaussians().mean(i)).collect::<Vec<_>>()
    };
    let of = |indices: &[usize]| indices.iter().map(|i| chunk.gaussians().mean(*i)).collect::<Vec<_>>();
    assert_eq!(means(load(Some(0), false).unwrap()), of(&[0, 2, 3]));
    assert_eq!(means(load(None, false).unwrap()), of(&[0, 2, 3]));
    assert_eq!(means(load(Some(1), false).unwrap()), of(&[1]));
    assert_eq!(means(load(Some(1), true).unwrap()), of(&[1, 0, 1, 2, 3]));
    assert_error(
        load(Some(2), true),
        &["lod-meta.json", "level of detail", "below 2, the number of", "found 2"],
    );
}

#[test]
fn a_budget_chooses_the_level_of_each_leaf() {
    let files = streamed_sog();
    let load = |gaussians, level_of_detail| {
        let budget = Some(Budget { gaussians, cameras: Vec::new() });
        let options = LoadOptions { level_of_detail, budget, environment: false, ..LoadOptions::default() };
        load_folder("lod-meta.json", &files, &options)
    };
    let count = |gaussians| load(gaussians, None).unwrap().gaussians().len();
    // The first leaf has two Gaussians, or one at its coarser level; the second leaf has one at its only level.
    assert_eq!([0, 2, 3, 100].map(count), [2, 2, 3, 3]);
    let coarse = load(2, None).unwrap();
    let level_1 = {
        let options = LoadOptions { level_of_detail: Some(1), environment: false, ..LoadOptions::default() };
        load_folder("lod-meta.json", &files, &options).unwrap()
    };
    let means = |scene: &gs3_scene::Scene| -> Vec<_> {
        (0..scene.gaussians().len()).map(|i| scene.gaussians().mean(i).map(f32::to_bits)).collect()
    };
    assert!(means(&coarse).contains(&means(&level_1)[0]));
    assert_error(load(2, Some(1)), &["lod-meta.json", "level of detail", "a budget or one level"]);
    // Of a scene in one piece nothing can be left out.
    for (gaussians, is_within) in [(4, true), (3, false)] {
        let budget = Some(Budget { gaussians, cameras: Vec::new() });
        let options = LoadOptions { budget, ..LoadOptions::default() };
        let loaded = load_folder("meta.json", &sog(), &options);
        assert_eq!(loaded.is_ok(), is_within);
        if !is_within {
            assert_error(
                loaded,
                &["meta.json", "Gaussians", "at most 3, or a streamed SOG scene", "found 4"],
            );
        }
    }
}

#[test]
fn levels_and_environment_are_known_before_loading() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    };
    // The index alone is enough.
    let index = streamed_sog()["lod-meta.json"].clone();
    let path = write("all/lod-meta.json", &index);
    let expected = Some(Streamed { levels: 2, has_environment: true, takes_budget: true });
    assert_eq!(streamed(&path).unwrap(), expected);
    assert_eq!(streamed(path.parent().unwrap()).unwrap(), expected);
    let bare = String::from_utf8(index).unwrap().replace("\"environment\":\"env/meta.json\",", "");
    let path = write("bare/lod-meta.json", bare.as_bytes());
    assert_eq!(
        streamed(&path).unwrap(),
        Some(Streamed { levels: 2, has_environment: false, takes_budget: true })
    );

    for (name, bytes) in [
        ("scene/meta.json", sog()["meta.json"].clone()),
        ("scene.sog", sog_bundle()),
        ("scene.ply", ply_text()),
        ("scene.spz", spz(3)),
        ("scene.splat", splat()),
    ] {
        let path = write(name, &bytes);
        assert_eq!(streamed(&path).unwrap(), None, "{name}");
    }
    let error = streamed(write("cut/lod-meta.json", b"{\"tree\":{},")).unwrap_err().to_string();
    assert!(error.contains("JSON"), "{error}");
    assert!(streamed(folder.path().join("nothing")).is_err());
}

#[test]
fn scenes_in_one_piece_have_one_level() {
    for (name, bytes) in
        [("s.sog", sog_bundle()), ("s.ply", ply_text()), ("s.spz", spz(3)), ("s.splat", splat())]
    {
        let load = |level| {
            let options =
                LoadOptions { level_of_detail: Some(level), environment: false, ..LoadOptions::default() };
            load_source(&Source::memory(name, bytes.as_slice()), &BTreeMap::new(), &options, &|_| {})
        };
        assert_eq!(load(0).unwrap(), load_bytes(name, &bytes).unwrap());
        assert_error(load(1), &[name, "level of detail", "one level", "found 1"]);
    }
}

#[test]
fn broken_meta_data_is_named() {
    let with = |from: &str, to: &str| {
        let mut files = sog();
        let meta = String::from_utf8(files["meta.json"].clone()).unwrap();
        assert!(meta.contains(from));
        files.insert("meta.json".to_owned(), meta.replace(from, to).into_bytes());
        load_folder("meta.json", &files, &LoadOptions::default())
    };
    assert_error(with("\"version\":2", "\"version\":3"), &["meta.json", "version", "1 or 2", "found 3"]);
    // Without a version it would be version 1, which has shapes.
    assert_error(with("\"version\":2,", ""), &["meta.json", "JSON", "shape"]);
    assert_error(with("\"count\":4", "\"count\":7"), &["means_l.webp", "7 pixels", "2 × 3"]);
    assert_error(with("\"count\":4", "\"count\":99999999999"), &["meta.json", "count", "99999999999"]);
    assert_error(with("\"count\":4", "\"count\":-4"), &["meta.json", "JSON"]);
    assert_error(with("\"bands\":1", "\"bands\":2"), &["shN_centroids.webp", "512 × 1", "192 × 1"]);
    assert_error(with("\"bands\":1", "\"bands\":4"), &["meta.json", "shN.bands", "3", "4"]);
    assert_error(with("\"count\":2", "\"count\":999"), &["shN_centroids.webp", "192 × 16"]);
    assert_error(with("scales.webp", "../../secret"), &["meta.json", "files", "inside", "../../secret"]);
    assert_error(with("scales.webp", "/etc/passwd"), &["meta.json", "files", "inside"]);
    assert_error(with("scales.webp", "other.webp"), &["other.webp"]);
    // Labels beyond the palette and codes without a value are invalid Gaussians, not invalid files.
    let scene = with("\"count\":2", "\"count\":1").unwrap();
    assert_eq!((scene.gaussians().len(), scene.dropped().non_finite_sh), (2, 2));
}

#[test]
fn a_null_at_the_start_of_a_codebook_is_extrapolated() {
    let mut files = sog();
    let meta = String::from_utf8(files["meta.json"].clone()).unwrap();
    let reference = load_folder("meta.json", &files, &LoadOptions::default()).unwrap();
    files.insert("meta.json".to_owned(), meta.replace("[-8,", "[null,").into_bytes());
    let scene = load_folder("meta.json", &files, &LoadOptions::default()).unwrap();
    // c₀ = c₁ + (c₁ − c₂₅₅) / 255, here −8.0000 + 0.0001.
    assert_close(&scene.gaussians().scale(0), &reference.gaussians().scale(0), 1e-5);
}

#[test]
fn broken_images_and_trees_are_named() {
    let with = |name: &str, bytes: Vec<u8>| {
        let mut files = sog();
        files.insert(name.to_owned(), bytes);
        load_folder("meta.json", &files, &LoadOptions::default())
    };
    assert_error(with("quats.webp", b"RIFF".to_vec()), &["quats.webp", "WebP"]);
    assert_error(with("sh0.webp", webp(1, ColorType::Rgba8, &[0; 4])), &["sh0.webp", "4 pixels", "1 × 1"]);
    // A reserved tag is a zero quaternion.
    let reserved = with("quats.webp", webp(2, ColorType::Rgba8, &[[128, 128, 128, 251]; 4].concat()));
    assert_error(reserved, &["meta.json", "4 dropped"]);

    let tree = |from: &str, to: &str| {
        let mut files = streamed_sog();
        let index = String::from_utf8(files["lod-meta.json"].clone()).unwrap();
        assert!(index.contains(from));
        files.insert("lod-meta.json".to_owned(), index.replace(from, to).into_bytes());
        load_folder("lod-meta.json", &files, &LoadOptions::default())
    };
    assert_error(
        tree("\"offset\":0", "\"offset\":2"),
        &["lod-meta.json", "tree", "overlap", "2..3 and 2..4"],
    );
    assert_error(
        tree("\"offset\":2", "\"offset\":3"),
        &["lod-meta.json", "tree", "4 Gaussians", "ends at 5"],
    );
    assert_error(tree("\"file\":0", "\"file\":9"), &["lod-meta.json", "tree", "file 9"]);
    let end = "\"offset\":18446744073709551615";
    assert_error(tree("\"offset\":2", end), &["lod-meta.json", "tree", "18446744073709551615"]);
    assert_error(tree("env/meta.json", "../meta.json"), &["lod-meta.json", "environment", "inside"]);
    assert_error(tree("0_0/meta.json", "0_9/meta.json"), &["0_9/meta.json"]);
    assert_error(tree("\"lodLevels\":2", "\"version\":2,\"lodLevels\":2"), &["lod-meta.json", "version"]);
}

#[test]
fn an_image_that_would_unpack_to_gigabytes_is_refused_before_it_does() {
    // 16,383 × 16,383 pixels of one colour: a kilobyte that asks for a gibibyte. Header and image data are
    // from a small image; only its stated size is changed.
    let mut image = webp(2, ColorType::Rgb8, &[0; 12]);
    let size = image.windows(4).position(|bytes| bytes == b"VP8L").unwrap() + 9;
    image[size..size + 4].copy_from_slice(&(16_382u32 << 14 | 16_382).to_le_bytes());
    let mut files = sog();
    files.insert("means_l.webp".to_owned(), image);
    let result = load_folder("meta.json", &files, &LoadOptions::default());
    assert_error(result, &["means_l.webp", "image", "at most 268435456 bytes", "1073610756"]);
}

/// ZIP has a checksum for each entry, which shows only at the entry's end.
#[test]
fn a_damaged_bundle_is_no_scene() {
    let whole = sog_bundle();
    let scene = load_bytes("b.sog", &whole).unwrap();
    for place in 0..whole.len() {
        let mut damaged = whole.clone();
        damaged[place] ^= 1;
        // Times, versions and the like mean nothing here.
        if let Ok(other) = load_bytes("b.sog", &damaged) {
            assert_eq!(other, scene, "byte {place}");
        }
    }
}

#[test]
fn a_cut_image_is_no_image() {
    let scene = load_folder("meta.json", &sog(), &LoadOptions::default()).unwrap();
    for (name, image) in sog().into_iter().filter(|(name, _)| name.ends_with(".webp")) {
        for length in 0..image.len() {
            let mut files = sog();
            files.insert(name.clone(), image[..length].to_vec());
            // The last byte may be there only to make their number even.
            match load_folder("meta.json", &files, &LoadOptions::default()) {
                Ok(cut) => assert!(cut == scene && length + 1 == image.len(), "{length} bytes of {name}"),
                Err(error) => assert!(error.to_string().starts_with(&name), "{error}"),
            }
        }
    }
}
