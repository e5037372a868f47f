//! Weights in files and in graphs.

use gs3_neural::arrays::{self, Array};
use gs3_neural::model::{Tier, initial_weights, interpolate, super_sample};
use gs3_neural::{Graph, Header, WeightError, Weights};

fn header(graph: &Graph) -> Header {
    Header {
        tier: "fast".to_owned(),
        training_data: "nothing".to_owned(),
        licence: "MIT OR Apache-2.0".to_owned(),
        ..Header::of(graph, 4)
    }
}

#[test]
fn weights_survive_a_file_bit_for_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    for graph in [super_sample(4, Tier::Fast), interpolate(4, Tier::Fast)] {
        let graph = graph.expect("a network");
        let weights = initial_weights(&graph, header(&graph), 7);
        weights.check(&graph).expect("its own");
        let path = folder.path().join("weights.safetensors");
        weights.save(&path).expect("written");
        assert_eq!(Weights::load(&path).expect("read"), weights);
        assert_eq!(initial_weights(&graph, header(&graph), 7), weights);
        assert_ne!(initial_weights(&graph, header(&graph), 8), weights);
    }
}

/// Where it replaced what it is given, one slip (`--out /dev/null`) would cost a system its device.
#[test]
#[cfg(unix)]
fn weights_go_through_links_and_into_pipes_and_replace_neither() {
    use std::os::unix::fs::FileTypeExt;
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let graph = super_sample(4, Tier::Fast).expect("a network");
    let weights = initial_weights(&graph, header(&graph), 7);
    std::os::unix::fs::symlink("far.safetensors", at("link.safetensors")).expect("a link");
    weights.save(at("link.safetensors")).expect("written");
    assert!(at("link.safetensors").is_symlink() && !at("far.safetensors").is_symlink());
    assert_eq!(Weights::load(at("far.safetensors")).expect("read"), weights);

    let pipe = at("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().expect("run").success());
    let reader = std::thread::spawn({
        let pipe = pipe.clone();
        move || Weights::load(&pipe)
    });
    weights.save(&pipe).expect("written");
    let found = std::fs::metadata(&pipe).expect("still there").file_type();
    assert!(found.is_fifo(), "the pipe was replaced");
    assert_eq!(reader.join().expect("ended").expect("read"), weights);
}

#[test]
#[cfg(target_os = "linux")]
fn files_without_end_are_refused_before_they_are_read() {
    let error = Weights::load("/dev/zero").expect_err("no weights").to_string();
    assert_eq!(error, "/dev/zero: path: expected a regular file or a pipe, found something else");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("huge.safetensors");
    std::fs::File::create(&path).expect("a file").set_len(arrays::MAX_BYTES + 1).expect("a size");
    let error = Weights::load(&path).expect_err("no weights").to_string();
    assert!(error.ends_with("size: expected at most 1073741824 bytes, found 1073741825"), "{error}");
}

#[test]
fn the_same_weights_always_have_the_same_bytes() {
    let graph = super_sample(4, Tier::Fast).expect("a network");
    let weights = initial_weights(&graph, header(&graph), 7);
    let bytes = weights.to_bytes().expect("bytes");
    // Six texts in the order of a hash map would come in another one at least once in twenty times, all but for 1 in
    // 10⁵⁷.
    for _ in 0..20 {
        assert!(weights.to_bytes().expect("bytes") == bytes, "other bytes");
    }
    let end = 8 + u64::from_le_bytes(bytes[..8].try_into().expect("eight")) as usize;
    let text = String::from_utf8(bytes[8..end].to_vec()).expect("a text");
    let place = |field: &str| text.find(&format!("\"{field}\":")).expect("there");
    let fields =
        ["__metadata__", "licence", "network", "scale", "tier", "training_data", "version", "enter.bias"];
    assert!(fields.windows(2).all(|pair| place(pair[0]) < place(pair[1])), "{text}");
    // Texts with quotes and the like survive.
    let mut odd = weights;
    odd.header.training_data = "\"quoted\", \\ and\n… ü".to_owned();
    assert_eq!(Weights::from_bytes(&odd.to_bytes().expect("bytes")).expect("read"), odd);
}

#[test]
fn weights_of_another_network_are_refused_by_name() {
    let [fast, balanced] = [Tier::Fast, Tier::Balanced].map(|t| super_sample(4, t).expect("a network"));
    let weights = initial_weights(&fast, header(&fast), 1);
    let error = weights.check(&balanced).expect_err("other shapes");
    assert_eq!(error.to_string(), "history.conv.weight: expected f32 [32, 147, 1, 1], found [16, 147, 1, 1]");
    let other = interpolate(4, Tier::Fast).expect("a network");
    assert!(matches!(weights.check(&other), Err(WeightError::Header { field: "network", .. })));

    let mut less = weights.clone();
    less.arrays.remove("enter.bias");
    assert!(matches!(less.check(&fast), Err(WeightError::Missing { name, .. }) if name == "enter.bias"));
    let mut more = weights.clone();
    more.arrays.insert("else".to_owned(), Array::default());
    assert!(matches!(more.check(&fast), Err(WeightError::Unknown { name }) if name == "else"));
    let mut wild = weights.clone();
    wild.arrays.get_mut("enter.bias").expect("there").values_mut()[0] = f32::NAN;
    assert!(matches!(wild.check(&fast), Err(WeightError::NotFinite { name, .. }) if name == "enter.bias"));
}

#[test]
fn broken_files_are_refused() {
    let graph = super_sample(2, Tier::Fast).expect("a network");
    let bytes = initial_weights(&graph, header(&graph), 1).to_bytes().expect("bytes");
    for end in [0, 7, 8, 100, bytes.len() - 1] {
        assert!(matches!(Weights::from_bytes(&bytes[..end]), Err(WeightError::Format { .. })), "{end} bytes");
    }
    let array = Array::new("a", &[1], vec![1.0]).expect("one number");
    let other = arrays::to_bytes(&Default::default(), &[("a".to_owned(), array)].into()).expect("bytes");
    assert!(matches!(Weights::from_bytes(&other), Err(WeightError::Header { field: "network", .. })));
    assert!(Array::new("a", &[2, 3], vec![0.0; 5]).is_err());
    assert!(Array::new("a", &[usize::MAX, 3], vec![0.0; 5]).is_err());
}
