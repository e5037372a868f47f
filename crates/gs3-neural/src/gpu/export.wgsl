// One word of the image per invocation: blocks of FACTOR² channels become pixels. `word` is written for the image's
// format.
fn number(at: u32) -> f32 {
    // A last half that is no number has a place beside one that is.
    let pixel = min(at / CHANNELS, PIXELS - 1u);
    let x = pixel % WIDTH;
    let y = pixel / WIDTH;
    let channel = (at % CHANNELS) * FACTOR * FACTOR + y % FACTOR * FACTOR + x % FACTOR;
    return part0_channel(channel, x / FACTOR, y / FACTOR);
}

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    let at = group_index(group) * 256u + index;
    if at < WORDS {
        result[at] = word(at);
    }
}
