// One number of the image per invocation: blocks of FACTOR² channels become pixels.
@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    let at = group_index(group) * 256u + index;
    if at < PIXELS * CHANNELS {
        let pixel = at / CHANNELS;
        let x = pixel % WIDTH;
        let y = pixel / WIDTH;
        let channel = (at % CHANNELS) * FACTOR * FACTOR + y % FACTOR * FACTOR + x % FACTOR;
        result[at] = Number(part0_channel(channel, x / FACTOR, y / FACTOR));
    }
}
