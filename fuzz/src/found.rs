//! What fuzzing found to reach code that the seeds do not reach, for the tests that replay it: `fuzz/found`.

use std::fs;
use std::io::Read;
use std::path::Path;

use flate2::read::GzDecoder;

/// The inputs in `folder/target.gz`, which `fuzz/found.py` packs: each is its length, a `u32` in little-endian, and its bytes.
pub fn found(folder: &Path, target: &str) -> Vec<Vec<u8>> {
    let file = folder.join(format!("{target}.gz"));
    let packed = fs::read(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    let mut bytes = Vec::new();
    GzDecoder::new(&packed[..]).read_to_end(&mut bytes).unwrap();
    let mut inputs = Vec::new();
    let mut rest = &bytes[..];
    while let Some((length, after)) = rest.split_first_chunk() {
        let (input, after) = after.split_at(u32::from_le_bytes(*length) as usize);
        inputs.push(input.to_vec());
        rest = after;
    }
    assert!(!inputs.is_empty(), "{} has no inputs", file.display());
    inputs
}
