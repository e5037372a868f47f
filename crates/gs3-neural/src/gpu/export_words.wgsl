// One word of the image per invocation, with numbers of two pixels. What is in capitals is written out by export.rs.
fn number(at: u32) -> f32 {
    // A last half that is no number has a place beside one that is.
    let pixel = min(at / CHANNELS, PIXELS - 1u);
    return value(at % CHANNELS, pixel % WIDTH, pixel / WIDTH);
}

@compute @workgroup_size(THREADS)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    let at = group_index(group) * THREADS + index;
    if at < WORDS {
        result[at] = WORD;
    }
}
