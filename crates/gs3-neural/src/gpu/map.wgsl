// One block of the result per invocation: `value` is written for the kernel.
@compute @workgroup_size(THREADS)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) index: u32) {
    let at = group_index(group) * THREADS + index;
    if at < PIXELS * BLOCKS {
        let pixel = at % PIXELS;
        result[at] = Block(value(at / PIXELS, pixel % WIDTH, pixel / WIDTH));
    }
}
