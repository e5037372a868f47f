//! `gs3 export`.

use std::fs;

use gs3::neural::model::{Tier, graph_of, initial_weights, super_sample};
use gs3::neural::{Header, onnx};

use super::{gs3, names, refused, succeed};

fn header() -> Header {
    Header {
        tier: "fast".to_owned(),
        training_data: "nothing".to_owned(),
        licence: "MIT OR Apache-2.0".to_owned(),
        ..Header::of(&super_sample(2, Tier::Fast).unwrap(), 2)
    }
}

#[test]
fn a_network_with_its_weights_becomes_an_onnx_file() {
    let folder = tempfile::tempdir().unwrap();
    let graph = graph_of(&header()).unwrap();
    let weights = initial_weights(&graph, header(), 1);
    weights.save(folder.path().join("w.safetensors")).unwrap();
    succeed(folder.path(), "export w.safetensors --out w.onnx");
    assert_eq!(fs::read(folder.path().join("w.onnx")).unwrap(), onnx::export(&graph, &weights).unwrap());
    assert_eq!(names(folder.path()), ["w.onnx", "w.safetensors"]);
}

#[test]
fn weights_that_fit_no_network_are_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let graph = graph_of(&header()).unwrap();
    let save = |name: &str, header: Header| {
        initial_weights(&graph, header, 1).save(at.join(name)).unwrap();
    };
    save("good.safetensors", header());
    save("tier.safetensors", Header { tier: "huge".to_owned(), ..header() });
    save("scale.safetensors", Header { scale: 99, ..header() });
    save("version.safetensors", Header { version: 999, ..header() });
    save("other.safetensors", Header { tier: "high".to_owned(), ..header() });
    fs::write(at.join("noise.safetensors"), [7; 100]).unwrap();
    fs::write(at.join("file"), "not a folder").unwrap();
    let before = names(at);
    for (arguments, expected) in [
        ("missing.safetensors --out o.onnx", "missing.safetensors"),
        ("noise.safetensors --out o.onnx", "noise.safetensors: expected safetensors"),
        ("tier.safetensors --out o.onnx", "tier: expected one of fast, balanced, high, found huge"),
        ("scale.safetensors --out o.onnx", "scale: expected 1 to 8, found 99"),
        ("version.safetensors --out o.onnx", ", found 999"),
        ("other.safetensors --out o.onnx", "expected f32 [48, "),
        ("good.safetensors --out good.safetensors", "--out: expected FILE.onnx, found good.safetensors"),
        ("good.safetensors --out file/o.onnx", "file/o.onnx: cannot be written"),
    ] {
        let said = refused(&mut gs3(at, &format!("export {arguments}")));
        assert!(said.contains(expected), "{arguments}: {said}");
        assert_eq!(names(at), before, "{arguments} leaves nothing");
    }
}
